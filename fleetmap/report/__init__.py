"""A run's report: one self-contained page, its picture and its charts; and figures of single maps."""

from fleetmap.report.charts import Chart, Curve, colour
from fleetmap.report.figures import plot_map
from fleetmap.report.html import Report, write_report
from fleetmap.report.picture import Trail, draw_map

__all__ = ["Chart", "Curve", "Report", "Trail", "colour", "draw_map", "plot_map", "write_report"]
