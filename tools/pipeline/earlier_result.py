"""An earlier result in the folder for a new one: the same command may replace it or go on with it, another may not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam._bounded import Unreadable, load_json, load_yaml, read_text

from ..common.changed_settings import CURE, refuse_changed
from ..common.errors import EarlierResultError

if TYPE_CHECKING:
    from maslam.mas.config import MasConfig
    from maslam.mas.manifest import Manifest

BEGUN = "unfinished.json"  # in a SEQS folder that is being made: its source and settings


def check_same_run(out: Path, config: MasConfig, made_of: Mapping[str, Any] | None = None) -> None:
    """:class:`EarlierResultError` where ``out`` holds a run of another source or with other settings than ``config``;
    ``made_of``: what is known of the sequences, as :func:`of_manifest` gives it, None before they are there."""
    settings = _read(out / "config.yaml")
    if settings is None:
        return
    if made_of is not None:
        _refuse_other(out, "a run", _read(out / "manifest.json") or {}, made_of)
    refuse_changed(out, "a run", settings, config.model_dump(mode="json"))


def check_same_sequences(out: Path, made_of: Mapping[str, Any]) -> None:
    """:class:`EarlierResultError` where ``out`` holds agent sequences, whole or begun, of something else than
    ``made_of``."""
    earlier = _read(out / BEGUN) or _read(out / "manifest.json")
    if earlier is not None:
        _refuse_other(out, "agent sequences", earlier, made_of)


def of_manifest(manifest: Manifest) -> dict[str, Any]:
    """Source and settings of a SEQS folder."""
    whole = manifest.model_dump(mode="json")
    settings = {name: value for name, value in whole["settings"].items() if name not in ("problems", "notes")}
    return {"source": whole["source"], "split": whole["split"], "settings": settings}


def _refuse_other(out: Path, what: str, earlier: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    there, wanted = earlier.get("source"), now["source"]
    if there != wanted:
        raise EarlierResultError(f"{out}: holds {what} of {there}, not of {wanted}; {CURE}")
    refuse_changed(out, what, {"split": earlier.get("split"), **(earlier.get("settings") or {})}, _flat(now))


def _flat(made_of: Mapping[str, Any]) -> dict[str, Any]:
    return {"split": made_of["split"], **made_of["settings"]}


def _read(path: Path) -> dict[str, Any] | None:
    """None where there is no such file; a damaged one is nobody's source."""
    try:
        text = read_text(path)
        content = load_yaml(text) if path.suffix == ".yaml" else load_json(text)
    except FileNotFoundError:
        return None
    except Unreadable:
        return {}
    return content if isinstance(content, dict) else {}
