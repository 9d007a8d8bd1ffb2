from casadical.measurements.derived_columns import derive as derive
