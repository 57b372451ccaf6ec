"""Summaries straight from a Parquet telemetry file: one pass, memory bounded by the batches in flight."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from threadpoolctl import threadpool_limits

from thetacomp.errors import InputError, Problem
from thetacomp.moments import Summary, SummaryBuilder, merge

_BATCH_ROWS = 8192
_MOST_READERS = 8  # each holds a few pages of every column in memory
# Without a read buffer, or with pre-buffering, whole row groups would be held at once.
_READ_BUFFER_BYTES = 1 << 16


def summarise_parquet(
    path: Path, inputs: Sequence[str], targets: Sequence[str], campaign_column: str | None = None
) -> tuple[Summary, ...]:
    """One summary per campaign of a Parquet file, in order of first appearance.

    `campaign_column` tells the campaigns apart; without it the whole file is one summary that carries the file's name.
    Rows with a missing value in one of the columns are skipped and counted, rows without a campaign too.
    InputError where the file cannot be read, a column is missing or a column is not numeric.
    """
    names = [*inputs, *targets]
    groups = _check(path, names, campaign_column)

    def one_group(group: int) -> list[Summary]:
        return _summarise_row_group(path, group, inputs, targets, campaign_column)

    # Row groups are shared out to the cores; a second level of threads inside BLAS would only get in their way.
    with (
        threadpool_limits(limits=1, user_api="blas"),
        ThreadPoolExecutor(min(_MOST_READERS, os.cpu_count() or 1)) as pool,
    ):
        parts = [part for group in pool.map(one_group, range(groups)) for part in group]
    by_name: dict[str, list[Summary]] = {}
    for part in parts:
        by_name.setdefault(part.name, []).append(part)
    return tuple(merge(same, name) for name, same in by_name.items())


def _check(path: Path, names: Sequence[str], campaign_column: str | None) -> int:
    """Number of row groups, once the file is known to hold what is asked for."""
    try:
        with pq.ParquetFile(path) as file:
            schema, groups = file.schema_arrow, int(file.num_row_groups)
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(
            [
                Problem(
                    "error", "parquet-unreadable", path.name, f"cannot be read as Parquet: {error}.", "Check the file."
                )
            ]
        ) from error
    wanted = list(dict.fromkeys([*names, *([campaign_column] if campaign_column else [])]))
    problems = [
        Problem(
            "error",
            "column-missing",
            path.name,
            f"the column is missing; the file has: {', '.join(schema.names)}.",
            "Rename the column in the file or ask for another one.",
            column=name,
        )
        for name in wanted
        if name not in schema.names
    ]
    problems += [
        Problem(
            "error",
            "column-not-numeric",
            path.name,
            f"expected numbers, found {schema.field(name).type}.",
            "Write the column as numbers.",
            column=name,
        )
        for name in names
        if name in schema.names and not _is_numeric(schema.field(name).type)
    ]
    if problems:
        raise InputError(problems)
    return groups


def _is_numeric(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def _summarise_row_group(
    path: Path, group: int, inputs: Sequence[str], targets: Sequence[str], campaign_column: str | None
) -> list[Summary]:
    names = [*inputs, *targets]
    builders: dict[str, SummaryBuilder] = {}
    buffer = np.empty((len(names), _BATCH_ROWS))
    wanted = list(dict.fromkeys([*names, *([campaign_column] if campaign_column else [])]))
    with pq.ParquetFile(path, pre_buffer=False, buffer_size=_READ_BUFFER_BYTES) as file:
        for batch in file.iter_batches(_BATCH_ROWS, row_groups=[group], columns=wanted, use_threads=False):
            rows = buffer[:, : batch.num_rows]
            for i, name in enumerate(names):
                rows[i] = _numbers(batch.column(name))
            for label, members in _campaigns(batch, campaign_column, path.stem):
                if label not in builders:
                    builders[label] = SummaryBuilder(inputs, targets, label)
                builders[label].add(rows if members is None else rows[:, members])
    return [builder.build() for builder in builders.values()]


def _numbers(column: pa.Array) -> np.ndarray[tuple[int], np.dtype[np.generic]]:
    """The values of a column, NaN where there is none."""
    if column.null_count:
        column = column.cast(pa.float64()).fill_null(np.nan)
    return np.from_dlpack(column)  # to_numpy() would import pandas


def _campaigns(
    batch: pa.RecordBatch, campaign_column: str | None, file_name: str
) -> list[tuple[str, np.ndarray[tuple[int], np.dtype[np.bool_]] | None]]:
    """Campaigns of a batch with the rows of each; None stands for all rows."""
    if campaign_column is None:
        return [(file_name, None)]
    encoded = batch.column(campaign_column)
    if not pa.types.is_dictionary(encoded.type):
        encoded = encoded.dictionary_encode()
    # A row without a campaign belongs to none: -1 is no index of the dictionary.
    index = np.from_dlpack(encoded.indices.cast(pa.int64()).fill_null(-1))
    labels = [str(label) for label in encoded.dictionary.to_pylist()]
    present = [int(i) for i in np.unique(index) if i >= 0]
    if len(present) == 1 and index.min() >= 0:
        return [(labels[present[0]], None)]
    first = {i: int((index == i).argmax()) for i in present}
    return [(labels[i], index == i) for i in sorted(present, key=first.__getitem__)]
