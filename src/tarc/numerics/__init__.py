"""Numerical tools: norms, semidefinite programs, ball arithmetic, tests of matrices."""
