"""Generated controller code: CasADi functions as guarded, deterministic C99 and structured text."""
