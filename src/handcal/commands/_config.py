"""The option --config: options by command from a TOML file; the command line wins.

[calibrate]
effects = ["gyro_scale", "lever_arm"]
heading-sigma = 5.0

[lab.size]
latitude = 48.1
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

OPTION = "--config"
# What is of one call and no habit.
NEVER = ("help", "version", "config", "install_completion", "show_completion")


def first(arguments: list[str]) -> list[str]:
    """The arguments with --config FILE before the command, wherever it was typed."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    for i, word in enumerate(arguments[:end]):
        taken = 2 if word == OPTION else 1 if word.startswith(f"{OPTION}=") else 0
        if taken:
            return arguments[i : i + taken] + arguments[:i] + arguments[i + taken :]
    return arguments


def defaults(path: Path, context: Any) -> dict[str, Any]:
    """Values of options by command, as the program takes them. Errors: InputError."""
    from handcal.documents import read_toml

    return _of_group(path, context.command, context, read_toml(path), "")


def _of_group(
    path: Path, group: Any, context: Any, table: Mapping[str, Any], name: str
) -> dict[str, Any]:
    """Of each command of a group; name: of the group, with a dot behind it."""
    from handcal.types import InputError

    out: dict[str, Any] = {}
    known = group.list_commands(context)
    for key, value in table.items():
        if key not in known:
            raise _unknown(path, f"there is no command '{name}{key}'", key, known)
        if not isinstance(value, dict):
            raise InputError(
                f"{path}: {name}{key} is a command: write its options below [{name}{key}]."
            )
        command = group.get_command(context, key)
        if hasattr(command, "list_commands"):
            out[key] = _of_group(path, command, context, value, f"{name}{key}.")
        else:
            out[key] = _of_command(path, command, value, f"{name}{key}")
    return out


def _of_command(path: Path, command: Any, table: Mapping[str, Any], name: str) -> dict[str, Any]:
    options = {
        long.removeprefix("--"): p
        for p in command.params
        if p.param_type_name == "option" and p.name not in NEVER
        for long in p.opts
        if long.startswith("--")
    }
    out = {}
    for key, value in table.items():
        option = options.get(key.replace("_", "-"))
        if option is None:
            raise _unknown(path, f"'{name}' has no option '{key}'", key, options)
        out[option.name] = _value(path, f"{name}.{key}", option, value)
    return out


def _value(path: Path, name: str, option: Any, value: Any) -> Any:
    """As it would be typed: a list is several times the option, or words with commas between."""
    from handcal.types import InputError

    items = value if isinstance(value, list) else [value]
    if any(isinstance(v, list | dict) for v in items):
        raise InputError(f"{path}: {name} is neither a number, a text nor a list of these.")
    if option.is_flag:
        if not isinstance(value, bool):
            raise InputError(f"{path}: {name} is either true or false.")
        return value
    if any(isinstance(v, bool) for v in items):
        raise InputError(f"{path}: {name} needs a value, not true or false.")
    words = [str(v) for v in items]
    return words if option.multiple else ",".join(words)


def _unknown(path: Path, problem: str, key: str, known: Iterable[str]) -> Exception:
    from handcal.did_you_mean import did_you_mean
    from handcal.types import InputError

    return InputError(f"{path}: {problem}.{did_you_mean(key.replace('_', '-'), known)}")
