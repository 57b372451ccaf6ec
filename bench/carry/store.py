"""The cache of the ruler: prepared measurements as numbers and names in one .npz, and digests of what made them."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

ROOMS = ("thetacomp.", "carry.")  # only classes of the program and of the ruler are made when a file is read


def digest(paths: Iterable[Path], *words: str) -> str:
    """Short digest of the text of files (of all modules below a folder) and of some words."""
    out = hashlib.blake2b(" ".join(words).encode(), digest_size=8)
    for path in paths:
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            out.update(file.name.encode() + file.read_bytes())
    return out.hexdigest()


def save(path: Path, value: object) -> None:
    """Write a tree of dataclasses, models, arrays and plain values."""
    arrays: dict[str, Any] = {}
    tree = json.dumps(_packed(value, arrays))
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.npz")
    np.savez(part, tree=np.array(tree), **arrays)
    part.rename(path)


def load(path: Path) -> Any:
    """What `save` wrote."""
    with np.load(path, allow_pickle=False) as file:
        return _unpacked(json.loads(str(file["tree"])), file)


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    if isinstance(value, np.ndarray):
        return {"array": _kept(value, arrays)}
    if isinstance(value, BaseModel):
        return {"model": _name(value), "of": value.model_dump(mode="json")}
    if is_dataclass(value):
        return {"class": _name(value), "of": {f.name: _packed(getattr(value, f.name), arrays) for f in fields(value)}}
    if isinstance(value, Mapping):
        return {"map": [[_packed(key, arrays), _packed(one, arrays)] for key, one in value.items()]}
    if isinstance(value, tuple | list):
        return {type(value).__name__: [_packed(one, arrays) for one in value]}
    if isinstance(value, datetime):
        return {"moment": value.isoformat()}
    return value.item() if isinstance(value, np.generic) else value


def _kept(value: Any, arrays: dict[str, Any]) -> str:
    """The name of an array in the file; equal ones, of which states have many, are written once."""
    content = np.ascontiguousarray(value)
    own = hashlib.blake2b(f"{value.dtype.str}{value.shape}".encode(), digest_size=16)
    own.update(content.view(np.uint8) if content.size else b"")
    arrays.setdefault(own.hexdigest(), value)
    return own.hexdigest()


def _unpacked(tree: Any, file: Mapping[str, Any]) -> Any:
    if not isinstance(tree, dict):
        return tree
    kind, of = next(iter(tree.items()))
    if kind == "array":
        return file[of]
    if kind == "model":
        return _class(of).model_validate(tree["of"])
    if kind == "class":
        return _class(of)(**{name: _unpacked(one, file) for name, one in tree["of"].items()})
    if kind == "map":
        return {_unpacked(key, file): _unpacked(one, file) for key, one in of}
    if kind == "moment":
        return datetime.fromisoformat(of)
    return (tuple if kind == "tuple" else list)(_unpacked(one, file) for one in of)


def _name(value: object) -> str:
    return f"{type(value).__module__}:{type(value).__qualname__}"


def _class(name: str) -> Any:
    module, _, qualname = name.partition(":")
    if not module.startswith(ROOMS):
        raise ValueError(f"{name} is no class of the program")
    return getattr(importlib.import_module(module), qualname)
