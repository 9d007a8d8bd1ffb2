from casadical.report.calibration import calibration_report as calibration_report
from casadical.report.diagnosis import diagnosis_report as diagnosis_report
from casadical.report.figures_of_calibration import calibration_figures as calibration_figures
from casadical.report.figures_of_diagnosis import diagnosis_figures as diagnosis_figures
from casadical.report.life import comparison_figures as comparison_figures
from casadical.report.life import comparison_report as comparison_report
from casadical.report.style import dark as dark
