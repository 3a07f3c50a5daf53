"""The command line: tracking, infill and refinement, diagnosis, export, and what serves them."""

import sys

import typer

from workbench.cli import screen
from workbench.cli.characters import CHARACTER_HELP, character
from workbench.cli.configuration import config_app
from workbench.cli.diagnosing import DIAGNOSE_HELP, diagnose
from workbench.cli.exporting import EXPORT_HELP, export
from workbench.cli.installation import info, of_the_program
from workbench.cli.landmarking import LANDMARKS_HELP, landmarks
from workbench.cli.models import model_app
from workbench.cli.over_time import INFILL_HELP, REESTIMATE_HELP, REFINE_HELP, infill, reestimate, refine
from workbench.cli.reproducing import REPRODUCE_HELP, reproduce
from workbench.cli.rigs import rig_app
from workbench.cli.servers import APP_HELP, lab, serve_app
from workbench.cli.servers import notebooks_folder as notebooks_folder
from workbench.cli.servers import working_copies as working_copies
from workbench.cli.sweeping import SWEEP_HELP, sweep
from workbench.cli.tracking import TRACK_HELP, demo, track
from workbench.cli.training import TRAIN_HELP, train
from workbench.cli.tuning import TUNE_HELP, tune
from workbench.cli.weights import weights_app
from workbench.errors import WorkbenchError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Face Energy Workbench: facial performance capture by optimisation.",
)
app.callback()(of_the_program)
app.command(help=TRACK_HELP)(track)
app.command(help=LANDMARKS_HELP)(landmarks)
app.command()(demo)
app.command(help=INFILL_HELP)(infill)
app.command(help=REFINE_HELP)(refine)
app.command(help=REESTIMATE_HELP)(reestimate)
app.command(help=DIAGNOSE_HELP)(diagnose)
app.command(help=SWEEP_HELP)(sweep)
app.command(help=TUNE_HELP)(tune)
app.command(help=EXPORT_HELP)(export)
app.command(help=CHARACTER_HELP)(character)
app.command(help=REPRODUCE_HELP)(reproduce)
app.add_typer(config_app, name="config")
app.add_typer(model_app, name="model")
app.add_typer(rig_app, name="rig")
app.add_typer(weights_app, name="weights")
app.command(help=TRAIN_HELP, no_args_is_help=True)(train)
app.command()(lab)
app.command("app", help=APP_HELP)(serve_app)
app.command()(info)
screen.with_plain_flags(app)


def main() -> None:
    """Entry point: errors that a user can mend are one sentence and exit code 2, warnings are notes."""
    try:
        with screen.warnings_as_notes():
            app()
    except WorkbenchError as error:
        screen.print_error(error)
        sys.exit(2)
