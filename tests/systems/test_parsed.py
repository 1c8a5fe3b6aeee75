import ast
import threading
import time

import pytest

from dynasindy.systems.tangents import parsed


def test_what_is_no_formula_is_refused():
    with pytest.raises(SyntaxError):
        parsed("a *")


def test_one_thread_parses_at_a_time(monkeypatch):
    at_it, most, real = [], [], ast.parse

    def slow(*args, **kwargs):
        at_it.append(1)
        most.append(len(at_it))
        time.sleep(0.01)
        at_it.pop()
        return real(*args, **kwargs)

    monkeypatch.setattr(ast, "parse", slow)
    threads = [threading.Thread(target=parsed, args=("a + b",)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1, 1]
