"""What every room may use and that knows of none: errors, frames, files, parameters, parts of a robot as plain data."""
