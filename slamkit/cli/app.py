"""The command ``slamkit``: its subcommands, and how it ends."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import slamkit
from slamkit.cli.compare import compare_filters
from slamkit.cli.demo import demo
from slamkit.cli.errors import FAILED, TRACEBACK, WRONG_USE, RunError, fail, reason
from slamkit.cli.fetch import fetch_set
from slamkit.cli.run import RunGroup
from slamkit.cli.simulate import simulate_world
from slamkit.cli.streams import adapt_streams
from slamkit.errors import SlamkitError

__all__ = ["app", "main"]


class Commands(TyperGroup):
    """Commands whose every error is one line on stderr, with an exit code that says what kind it is."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command that the arguments name, and leave with its exit code."""
        run = partial(super().main, args, prog_name, complete_var, False, windows_expand_args, **extra)
        if not standalone_mode:
            return run()
        adapt_streams()
        try:
            code = run()
        except BrokenPipeError:
            # The reader of standard output has left, as `| head` does. Python must not flush what is left to it.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(FAILED)
        except RunError as error:
            fail(reason(error), FAILED, error)
        except (SlamkitError, OSError) as error:
            fail(reason(error), WRONG_USE, error)
        except Exception as error:
            # Usage errors belong to Click or to Typer's copy of it, depending on Typer's version.
            if hasattr(error, "format_message"):
                context = getattr(error, "ctx", None)
                hint = "" if context is None else f" (see {context.command_path} --help)"
                fail(f"{error.format_message()}{hint}", WRONG_USE, error)
            # Typer ends an interrupted command with a RuntimeError of its own.
            if type(error).__name__ in ("Abort", "Exit"):
                raise
            fail(f"{reason(error)} (set {TRACEBACK}=1 to see where)", FAILED, error)
        sys.exit(code or 0)


app = typer.Typer(
    cls=Commands,
    name="slamkit",
    help="Filter-based landmark SLAM: run filters on simulated and recorded logs, and measure them.\n\n"
    f"Exit codes: 0 success; {FAILED} the run failed, for example it diverged; {WRONG_USE} an option or a file that "
    "was given does not fit; 130 interrupted.",
    epilog="Example: slamkit demo --out demo",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for name, command, example in (
    ("demo", demo, "slamkit demo --out demo"),
    ("simulate", simulate_world, "slamkit simulate loop --seed 1 --out loop && slamkit run csv loop"),
    (
        "compare",
        compare_filters,
        "slamkit compare --world loop --filters ekf,fej,ideal --runs 10 --out study",
    ),
    ("fetch", fetch_set, "slamkit fetch mrclam 1 --folder data"),
):
    app.command(name, epilog=f"Example: {example}")(command)
app.add_typer(
    typer.Typer(
        cls=RunGroup,
        help="Run a filter over a recorded log and compare it with the truth and with dead reckoning.",
        epilog="Example: slamkit run mrclam MRCLAM_Dataset1.zip --robot 1",
    ),
    name="run",
)


def main() -> None:
    """The console script `slamkit`."""
    app(prog_name="slamkit")


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"slamkit {slamkit.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())
