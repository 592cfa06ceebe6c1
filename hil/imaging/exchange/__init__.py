"""Geometry of exposures in other programs' files: 3 x 4 matrices, RTK's XML, DICOM's X-ray angiography attributes, vectors."""
