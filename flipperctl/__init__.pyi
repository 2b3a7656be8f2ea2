from typing import TYPE_CHECKING

if TYPE_CHECKING:  # mypy then checks what the interface imports before the package, as it is run
    from flipperctl.scripting import Evaluation as Evaluation
    from flipperctl.scripting import LoadedPolicy as LoadedPolicy
    from flipperctl.scripting import Run as Run
    from flipperctl.scripting import environment as environment
    from flipperctl.scripting import evaluate as evaluate
    from flipperctl.scripting import load as load
    from flipperctl.scripting import plot as plot
    from flipperctl.scripting import save as save
    from flipperctl.scripting import train as train

__version__: str
