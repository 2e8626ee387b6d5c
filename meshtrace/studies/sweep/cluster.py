"""The cluster that computes the tasks of a sweep, and the bar that shows how far it is."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from meshtrace.errors import Described, Refused
from meshtrace.studies.sweep.points import Outcome, Study, Task, one_line
from meshtrace.studies.sweep.store import note, write

if TYPE_CHECKING:
    import distributed
    import zarr


def compute(
    study: Study,
    group: zarr.Group,
    tasks: list[Task],
    scheduler: str | None,
    workers: int | None,
    progress: bool,
) -> None:
    """Run tasks on a cluster and write each as it finishes."""
    import distributed

    with _client(scheduler, workers) as client, _bar(client, len(tasks), progress) as advance:
        futures = client.map(_run, tasks, study=study, pure=False)
        of = dict(zip((future.key for future in futures), tasks, strict=True))
        for future in distributed.as_completed(futures):
            task = of[future.key]
            if future.status == "finished":
                write(group, task, future.result())
            else:
                note(group, task, one_line(future.exception()))
            future.release()
            advance()


def _run(task: Task, study: Study) -> Outcome:
    return study.compute(task)


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[distributed.Client]:
    """Yield a client of a running scheduler or of a new cluster on this machine."""
    import distributed

    if scheduler is None:
        # one thread each: a task fills one core, and dask keeps BLAS to one thread as well
        with (
            distributed.LocalCluster(
                n_workers=workers or os.cpu_count() or 1,
                threads_per_worker=1,
                processes=True,
                dashboard_address=":0",
                silence_logs=logging.ERROR,
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            client.register_plugin(_leave_interrupts())
            yield client
        return
    try:
        client = distributed.Client(scheduler)
    except (OSError, ValueError) as error:
        raise Refused(
            "scheduler",
            Described(f"{scheduler!r}: {one_line(error)}"),
            "the address of a running dask scheduler",
        ) from error
    with client:
        yield client


def _leave_interrupts() -> distributed.WorkerPlugin:
    """Return a plugin that leaves Ctrl-C, which the terminal sends to all, to the client."""
    import distributed

    class LeaveInterrupts(distributed.WorkerPlugin):
        def setup(self, worker: distributed.Worker) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return LeaveInterrupts()


@contextmanager
def _bar(client: distributed.Client, total: int, shown: bool) -> Iterator[Callable[[], None]]:
    """Print where the dashboard is and show a bar; yield how to say that a task is done."""
    if not shown:
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(file=sys.stderr)
    console.print(f"dashboard: {client.dashboard_link}", highlight=False, soft_wrap=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        row = bar.add_task("sweep", total=total)
        yield lambda: bar.advance(row)
