from dynasindy.viz.report import data
from dynasindy.viz.report.document import Picture, Text, Verdict


def missing(section):
    return [part for part in section.parts if isinstance(part, Text) and part.words.startswith("Not measured")]


def pictures(section):
    return [part.name for part in section.parts if isinstance(part, Picture)]


def test_the_excitation_and_the_training_data_are_drawn_and_counted(results):
    chirp, training = data.chirp_input(results), data.training(results)
    assert pictures(chirp) == ["excitation_xi"] and pictures(training) == ["training_data_xi"]
    assert len(missing(chirp)) == len(missing(training)) == 1
    assert "`u_p` 0.00 to 0.99" in chirp.findings[0].ours and chirp.findings[0].verdict is Verdict.AS
    assert training.findings[0].verdict is Verdict.AS and training.findings[0].ours.startswith(
        "1000 samples, 0.01 s apart"
    )
