"""Small figures for the notebooks: rows of pictures, bars, curves, matrices. Each function returns a Figure.

Figures do not use pyplot's list of open figures, so a cell that ends with a figure shows it only once.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
