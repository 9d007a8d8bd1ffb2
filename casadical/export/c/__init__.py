"""Functions as C99, structured text and an FMU: the same tape of operations in each language."""
