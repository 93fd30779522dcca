"""Loops over samples as compiled code. Each file stands alone: the compiler's cache on disk knows a function's own file only."""
