"""What every room may use: errors, frames, files, parameters, parts of a robot as plain data. It imports no room."""
