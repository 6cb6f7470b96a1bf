"""Outputs that are there already: written by an earlier attempt, or with a record that says how they were made."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path

from prc_cli.core.files import is_same, parts_of, read_small
from prc_cli.formats.writing.record import LARGEST_RECORD, RunRecord, fingerprint, record_path
from prc_cli.jobs.batch.types import Done, InputPrint, Task
from prc_cli.jobs.choice import possible_configs


def outcome_of_record(task: Task, before: InputPrint, written: os.stat_result) -> Done | None:
    """Return the outcome of an existing output if its run record equals the one that would be written.

    Doubts that are accepted are not compared. Whether the output is still the one that was recorded, :func:`is_whole`
    tells.
    """
    try:
        record = json.loads(read_small(record_path(task.output), LARGEST_RECORD))
        trajectory = None if task.config.trajectory is None else fingerprint(task.config.trajectory)
        content = fingerprint(task.source)
        records = [
            RunRecord(config.of_run(), content, "", 1, trajectory=trajectory).as_dict()
            for config in possible_configs(task.config)
        ]
        for one in (record, *records):
            one["config"].get("input", {}).pop("accept_doubts", None)
        keys = ("program", "version", "config", "input", "trajectory")
        wanted = next((one for one in records if all(record[key] == one[key] for key in keys)), None)
        if wanted is None:
            return None
        stream = record["stream"]
        missing = ("missing", int(stream["n_missing"] or 0))
        labels = tuple((str(count["name"]), int(count["count"])) for count in record["classes"])
        return Done(
            name=task.name, input=InputPrint(before.size, before.mtime_ns, wanted["input"]["sha256"]),
            output_size=int(record["output"]["size"]), output_mtime_ns=written.st_mtime_ns,
            seconds=0.0, cpu_seconds=0.0, peak_mib=None, n_lines=int(stream["n_lines"] or 0),
            n_shots=int(stream["n_lines"] or 0) * int(stream["points_per_line"]),
            n_records=int(stream["n_records"] or 0), labels=(missing, *labels),
            notices=tuple(str(text) for text in record["notices"]),
            output_name=task.output.name, output_sha256=str(record["output"]["sha256"]),
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        return None


def is_whole(output: Path, written: os.stat_result, done: Done) -> bool:
    """Tell whether an output has the size and the content that were recorded; reads it."""
    return written.st_size == done.output_size and fingerprint(output).sha256 == done.output_sha256


def remove_unfinished(task: Task) -> bool:
    """Remove an output whose process died between giving it its name and finishing; tell whether it was one.

    Its temporary file is still there, and is the same file (:func:`prc_cli.core.files.place`). On whichever machine
    that was: the caller has the order to write the output now.
    """
    found = False
    for path in (record_path(task.output), task.output):
        with contextlib.suppress(OSError):
            for part in tuple(parts_of(path)):
                if is_same(part, path):
                    path.unlink()
                    part.unlink()
                    found = True
    return found
