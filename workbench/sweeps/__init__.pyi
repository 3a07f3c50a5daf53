from .solving import ClipSolver as ClipSolver
