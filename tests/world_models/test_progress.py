"""A fit that takes long says what it does; a short one, and one nobody listens to, say nothing."""

import logging

from dynasindy.world_models.progress import LOG, Progress


def test_steps_are_counted_and_named_while_inside(capsys):
    with Progress(after=0.0) as progress:
        LOG.info("fit of %d coefficients", 19)
        progress.bar.refresh()
        LOG.info("choice among %d", 7)
        assert progress.bar.n == 2 and progress.bar.desc.strip(": ") == "choice among 7"
    LOG.info("nobody listens")
    assert progress.bar.n == 2
    assert "fit of 19 coefficients" in capsys.readouterr().err


def test_a_short_fit_says_nothing_and_the_logger_is_as_it_was(capsys):
    before = LOG.level, list(LOG.handlers), LOG.propagate
    with Progress(after=60.0):
        LOG.info("a step")
    assert capsys.readouterr().err == ""
    assert (LOG.level, LOG.handlers, LOG.propagate) == before
    assert not LOG.isEnabledFor(logging.INFO)
