"""What is compiled is kept on disk as long as no kernel has changed."""

from meshtrace.kernels import jit


def double(x):
    return 2.0 * x


def hits_of_a_call():
    compiled = jit.entry(double)
    assert compiled(1.5) == 3.0
    return sum(compiled.stats.cache_hits.values())


def test_a_change_in_any_kernel_is_noticed(monkeypatch):
    with monkeypatch.context() as changed:
        changed.setattr(jit, "sources", lambda: b"first")
        hits_of_a_call()
        assert hits_of_a_call() == 1
        changed.setattr(jit, "sources", lambda: b"second")
        assert hits_of_a_call() == 0
        assert hits_of_a_call() == 1
