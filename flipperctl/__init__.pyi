from typing import TYPE_CHECKING

if TYPE_CHECKING:  # mypy then checks what the interface imports before the package, as it is run
    from flipperctl.library import Evaluation as Evaluation
    from flipperctl.library import LoadedPolicy as LoadedPolicy
    from flipperctl.library import Run as Run
    from flipperctl.library import evaluate as evaluate
    from flipperctl.library import load as load
    from flipperctl.library import train as train

__version__: str
