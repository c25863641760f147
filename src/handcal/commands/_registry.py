"""How the command line finds its commands, and how it ends.

Each entry of the entry-point group ``handcal.commands`` names a package: every module in it that
does not begin with an underscore is a command, a function of the module's name with typer
annotations, imported only when called; a package in it holds the commands of a command. An entry
``module:name`` is one such function alone.
"""

from __future__ import annotations

import ast
import codecs
import contextlib
import importlib
import importlib.util
import inspect
import io
import os
import pkgutil
import sys
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from handcal.commands._config import first
from handcal.commands._ending import INTERRUPTED, Ended, listen

FIRST = ("demo", "calibrate", "explain", "replay", "import", "simulate")
GROUP = "handcal.commands"


class Commands(TyperGroup):
    """The commands of this file and of the entry points; errors become one line and a status."""

    listing = False

    @cached_property
    def plugins(self) -> dict[str, EntryPoint]:
        """Where the commands are that are imported only when called, by name."""
        return _plugins()

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Names, the most used first."""
        names = {*self.commands, *self.plugins}
        order = {name: n for n, name in enumerate(FIRST)}
        return sorted(names, key=lambda name: (order.get(name, len(order)), name))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002
        """The command; for the list of commands only its name and its first line."""
        plugin = self.plugins.get(cmd_name)
        if cmd_name in self.commands or plugin is None:
            return self.commands.get(cmd_name)
        if self.listing:
            return TyperCommand(cmd_name, help=_first_line(plugin))
        return _loaded(plugin)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """The list of commands, without importing any of them."""
        self.listing = True
        try:
            super().format_help(ctx, formatter)
        finally:
            self.listing = False

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that is called; of one that there is not, the nearest names are said."""
        name = args[0]
        if not name.startswith("-") and name not in self.list_commands(ctx):
            from handcal.did_you_mean import did_you_mean

            ctx.fail(f"No such command '{name}'.{did_you_mean(name, self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command; what goes wrong for a known reason ends in one line on stderr."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            say("interrupted")
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:
            raise
        except MemoryError as error:
            say(f"Not enough memory: {error or 'no more is to be had'}.")
            raise typer.Exit(1) from None
        except OSError as error:
            say(f"{error.filename or 'Output'}: {error.strerror or error}.")
            raise typer.Exit(1) from None
        except Exception as error:
            from handcal.types import HandcalError, InputError

            if not isinstance(error, HandcalError):
                raise
            say(str(error))
            raise typer.Exit(2 if isinstance(error, InputError) else 1) from None


def group(package: str) -> typer.Typer:
    """The command whose commands are the modules of a package."""

    class Group(Commands):
        @cached_property
        def plugins(self) -> dict[str, EntryPoint]:
            return folder(package)

    return typer.Typer(
        cls=Group, add_completion=False, pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )  # fmt: skip


def folder(package: str) -> dict[str, EntryPoint]:
    """The commands of a package, by name; none of them is imported."""
    found: dict[str, EntryPoint] = {}
    with contextlib.suppress(ImportError):  # (of a program that was installed, and broke)
        for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
            if not module.name.startswith("_"):
                name = module.name.strip("_").replace("_", "-")
                attribute = "commands" if module.ispkg else module.name
                found[name] = EntryPoint(name, f"{package}.{module.name}:{attribute}", GROUP)
    return found


def _plugins() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for entry in sorted(entry_points(group=GROUP), key=lambda e: e.name):
        found |= {entry.name: entry} if entry.attr else folder(entry.module)
    return found


def _first_line(plugin: EntryPoint) -> str:
    """The first line of the function's docstring, or of its module's where it is no function,
    read from the source without running it."""
    with contextlib.suppress(ImportError, OSError, SyntaxError, AttributeError, ValueError):
        spec = importlib.util.find_spec(plugin.module)
        if spec and spec.origin:
            text = Path(spec.origin).read_text(encoding="utf-8")
            return _docstring(text, plugin.attr).split("\n\n")[0]
    return f"from {plugin.dist.name}" if plugin.dist else "not installed completely"


def _docstring(source: str, name: str) -> str:
    """Of the function of this name, or of the module where it has none."""
    # (to parse all the commands takes twice as long as all else that handcal does for its help)
    at = source.find(f"\ndef {name}(")
    begin = source.find('"""', at)
    end = source.find('"""', begin + 3) + 3
    if 0 <= at < begin < end and source[:begin].endswith(":\n    "):
        return inspect.cleandoc(ast.literal_eval(source[begin:end]))
    module = ast.parse(source)
    named = (n for n in module.body if getattr(n, "name", "") == name)
    node = next((n for n in named if isinstance(n, ast.FunctionDef)), module)
    return ast.get_docstring(node) or ""


def _loaded(plugin: EntryPoint) -> Any:
    from handcal.types import HandcalError

    try:
        function = plugin.load()
    except (ImportError, AttributeError, SyntaxError) as e:
        raise HandcalError(f"The command '{plugin.name}' could not be loaded: {e}.") from e
    if isinstance(function, typer.Typer):
        return typer.main.get_command(function)
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    single.command(plugin.name)(function)
    return typer.main.get_command(single)


# Signs that an old terminal may lack, and what stands for them there.
PLAIN = str.maketrans(
    {"−": "-", "–": "-", "±": "+-", "×": "x", "·": "*", "°": " deg", "σ": "sigma", "µ": "u",
     "μ": "u", "²": "^2", "³": "^3", "√": "sqrt", "≤": "<=", "≥": ">=", "→": "->", "…": "...",
     "\u00a0": " ", "\u202f": " ", "’": "'", "•": "*",
     **dict(zip("⁻⁰¹⁴⁵⁶⁷⁸⁹", "-01456789", strict=True)),
     **dict(zip("▁▂▃▄▅▆▇█", "_.-=+*#@", strict=True))}
)  # fmt: skip


def plain_signs(error: UnicodeError) -> tuple[str, int]:
    """What is written where a terminal cannot show a sign: one that it can."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end].translate(PLAIN)
    return "".join(c if c.isascii() else "?" for c in text), error.end


def _show_what_can_be_shown() -> None:
    for name in ("stdin", "stdout", "stderr"):
        # Closed by the parent process: nothing is to take its place.
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r+", encoding="utf-8"))  # noqa: SIM115
    codecs.register_error("handcal", plain_signs)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="handcal")


def say(text: str) -> None:
    """One line on stderr, in which nothing (a file's name) commands the terminal."""
    print(f"handcal: {_one_line(text)}", file=sys.stderr, flush=True)


def tell(text: str) -> None:
    """One line on stdout, what a command has done; likewise."""
    print(_one_line(text))


def _one_line(text: str) -> str:
    """Line breaks and what is beside them as one space; what stands in columns stays so."""
    lines = [part for part in text.splitlines() if part.strip()]
    line = " ".join(part.strip() for part in lines) if len(lines) > 1 else "".join(lines).rstrip()
    return "".join(" " if c.isspace() else c if c.isprintable() else "?" for c in line)


def run(app: typer.Typer) -> NoReturn:
    """Run the command line and leave by SystemExit; wrong use is one line, not a page."""
    arguments = first(sys.argv[1:]) or ["--help"]
    _show_what_can_be_shown()
    ended = Ended()
    try:
        try:
            listen(ended)
            command = typer.main.get_command(app)
            status = command.main(arguments, prog_name="handcal", standalone_mode=False)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    except (KeyboardInterrupt, typer.Abort):  # before or after the command itself
        say("interrupted")
        status = INTERRUPTED
    except Exception as error:
        if ended.status is not None:  # (and this is what came of an exception that was swallowed)
            sys.exit(ended.status)
        if not hasattr(error, "format_message"):  # of every usage error, whichever click it is
            raise
        context = getattr(error, "ctx", None)
        path = context.command_path if context else "handcal"
        problem = error.format_message().replace("Value error, ", "")
        end = "" if problem.endswith((".", "?")) else "."
        say(f"{problem}{end} See '{path} --help'.")
        status = 2
    sys.exit(status if isinstance(status, int) else 0)
