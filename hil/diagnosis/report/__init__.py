"""The report page of a diagnosis: figures and one self-contained HTML file. Drawing only; everything is computed elsewhere."""

from hil.diagnosis.report.page import write_report

__all__ = ["write_report"]
