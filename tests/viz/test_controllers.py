from dynasindy.viz.style import BLUE, CONTROLLERS, GREEN, RED, controller_name, line_styles


def test_a_controller_looks_the_same_by_its_setting_and_by_its_words_in_every_company():
    solid = {"linestyle": "-"}
    assert line_styles(["gradient", "rollouts_0"]) == {
        "gradient": {"color": BLUE, **solid},
        "rollouts_0": {"color": RED, **solid},
    }
    assert line_styles(["no planning", "x", "800 rollouts"]) == {
        "no planning": {"color": RED, **solid},
        "x": {"color": BLUE, **solid},
        "800 rollouts": {"color": GREEN, **solid},
    }
    assert len({look["color"] for look in line_styles("abcdef").values()}) == 6


def test_names_are_words_and_unique():
    assert controller_name("rollouts_0") == "no planning" and controller_name("horizon_20") == "horizon 20"
    assert controller_name("rollouts_4") == "4 rollouts"
    assert controller_name("horizon_20,agent.tau=0.1") == "horizon_20,agent.tau=0.1"
    words = [controller_name(setting) for setting in CONTROLLERS]
    assert len(set(words)) == len(words) and not any("_" in word for word in words)
