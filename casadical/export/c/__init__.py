"""Functions as C99 and structured text: the same tape of operations in each language."""
