"""Many machines, many nights: what is new is computed, on one computer or a Dask cluster, and kept as Parquet."""
