"""JupyterLab's server as a program: `python -m workbench.cli.lab_server`, with the arguments of `jupyter lab`.

What Jupyter's packages deprecate among themselves is not printed: it says nothing to a user. `-W` cannot do that where
Voilà is installed, because its import switches such warnings on again.
"""

import warnings
from contextlib import suppress

if __name__ == "__main__":
    from jupyterlab.labapp import main

    with suppress(ImportError):
        import voila  # noqa: F401
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    main()
