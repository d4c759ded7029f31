"""Threads that share work."""

import threading
import time

import pytest

from lunar_rover_sim.base.workers import Workers


@pytest.fixture(params=[1, 2, 4])
def workers(request):
    shared = Workers(request.param)
    yield shared
    shared.release()


def test_every_task_is_done_once_and_results_are_in_order(workers):
    done = []

    def work(k, other):
        done.append(k)
        time.sleep(0.001 * (k % 3))
        return k + other
    assert workers.map(work, [(k, 100) for k in range(50)]) == list(range(100, 150))
    assert sorted(done) == list(range(50))
    assert workers.map(work, []) == []


def test_threads_work_at_once_and_the_one_that_asks_is_one_of_them():
    """Each of four waits until all are at work."""
    workers, meeting = Workers(4), threading.Barrier(4)

    def meet():
        meeting.wait(30.0)
        return threading.get_ident()
    found = workers.map(meet, [()] * 4)
    assert len(set(found)) == 4 and threading.get_ident() in found
    workers.release()


def test_a_thread_that_is_busy_is_not_waited_for():
    """Two threads ask at once; the only helper works for the first one all the time."""
    workers, begun, go_on = Workers(2), threading.Barrier(3), threading.Event()

    def first():
        begun.wait(30.0)
        assert go_on.wait(30.0)
    asking = threading.Thread(target=workers.map, args=(first, [(), ()]))
    asking.start()
    begun.wait(30.0)
    assert workers.map(threading.get_ident, [()] * 5) == [threading.get_ident()] * 5
    go_on.set()
    asking.join()
    workers.release()


@pytest.mark.parametrize('fails_here', [True, False])
def test_an_error_is_raised_when_no_task_is_under_way(fails_here):
    workers, both, ended = Workers(2), threading.Barrier(2), []
    here = threading.get_ident()

    def work():
        both.wait(30.0)
        if (threading.get_ident() == here) == fails_here:
            raise ValueError('no light')
        time.sleep(0.05)
        ended.append(True)
    with pytest.raises(ValueError, match='no light'):
        workers.map(work, [(), ()])
    assert ended == [True]
    workers.release()


@pytest.mark.parametrize('count, size, parts', [(1, 480, 1), (2, 480, 2), (8, 480, 8), (8, 40, 2),
                                                (8, 5, 1)])
def test_rows_are_shared_out_whole_and_in_order(count, size, parts):
    """A thread gets 16 rows or more, if there are as many."""
    workers = Workers(count)
    rows = workers.rows(lambda first, end, step: range(first, end, step), size, 1)
    assert [row for part in rows for row in part] == list(range(size)) and len(rows) == parts
    assert workers.shares(size) == [(part.start, part.stop) for part in rows]
    workers.release()
