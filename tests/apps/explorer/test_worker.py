"""The worker: the newest job wins, others end at their next check."""

import threading

from meshtrace.apps.explorer.session import Superseded, Worker


def test_the_running_job_ends_and_waiting_ones_are_left_out():
    errors, done, started, go_on = [], [], threading.Event(), threading.Event()
    worker = Worker(errors.append)

    def first(ticket):
        started.set()
        assert go_on.wait(10.0)
        done.append("first began")
        ticket.check()
        done.append("first ended")

    worker.submit(first)
    assert started.wait(10.0)
    for name in ("second", "third", "newest"):
        worker.submit(lambda ticket, name=name: done.append((name, not ticket.is_set())))
    go_on.set()
    assert worker.wait(10.0)
    assert done == ["first began", ("newest", True)]
    assert errors == []
    worker.close()


def test_a_resting_job_ends_at_once_for_a_newer_one():
    done, resting = [], threading.Event()
    worker = Worker(lambda error: None)

    def job(ticket):
        ticket.rest(0.01)
        done.append("rested")
        resting.set()
        ticket.rest(60.0)
        done.append("not superseded")

    worker.submit(job)
    assert resting.wait(10.0)
    worker.submit(lambda ticket: done.append("newest"))
    assert worker.wait(10.0)
    assert done == ["rested", "newest"]
    worker.close()


def test_an_error_is_reported_and_the_next_job_runs():
    errors, done = [], []
    worker = Worker(errors.append)
    worker.submit(lambda ticket: 1 / 0)
    assert worker.wait(10.0)
    worker.submit(lambda ticket: done.append(1))
    assert worker.wait(10.0)
    assert [type(e) for e in errors] == [ZeroDivisionError]
    assert done == [1]
    worker.close()


def test_closing_ends_the_job_and_the_thread():
    started, ended = threading.Event(), threading.Event()
    worker = Worker(lambda error: None)

    def job(ticket):
        started.set()
        try:
            while True:
                ticket.check()
        except Superseded:
            ended.set()
            raise

    worker.submit(job)
    assert started.wait(10.0)
    worker.close()
    assert ended.wait(10.0)
    worker.join()
    worker.submit(lambda ticket: started.clear())
    assert worker.wait(10.0)
    assert started.is_set()
