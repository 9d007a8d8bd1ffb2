from casadical.measurements.columns import Columns as Columns
from casadical.measurements.derived_columns import derive as derive
from casadical.measurements.kinds.base import MeasurementKind as MeasurementKind
from casadical.measurements.kinds.base import PoseExpression as PoseExpression
