"""The report page of a diagnosis: figures and one self-contained HTML file. Drawing only; everything is computed elsewhere."""
