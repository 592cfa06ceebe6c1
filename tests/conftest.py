"""What all tests share: small matrices on one thread. Several workers' BLAS threads spinning against each other cost a hundredfold."""

import os

for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
