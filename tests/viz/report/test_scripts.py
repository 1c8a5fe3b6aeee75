"""The scripts of the page, run by node: what they draw, read out and remember."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dynasindy.viz.learning import average_rewards
from dynasindy.viz.report import page
from dynasindy.viz.report.chart import chart
from dynasindy.viz.response import tracking

HERE = Path(page.__file__).parent
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
TIME = np.arange(101) * 0.2


def run(code: str, **given):
    """Return what `code` makes of `given`; `R` is what draws."""
    names = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in given.items())
    script = f"const R = require({json.dumps(str(HERE / 'chart.js'))});\n{names}"
    done = subprocess.run(
        ["node", "-e", f"{script}console.log(JSON.stringify({code}))"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def outlines(element: str) -> list[list[list[float]]]:
    """Return the points of the lines that are drawn, the grid and the frame aside."""
    paths = re.findall(r'<path d="([^"]+)" stroke=', element)
    return [[list(map(float, point.split())) for point in re.findall(r"[\d.-]+ [\d.-]+", path)] for path in paths]


def test_ticks_are_round_and_within_the_limits():
    found = run(
        "[R.ticks('linear', 0, 20, 5), R.ticks('linear', -1.08, 1.08, 5), R.ticks('log', 2e-8, 0.3, 4),"
        " R.ticks('symlog', -2000, 90, 6), R.ticks('log', 2, 7, 5), R.ticks('linear', 0.3991, 0.4012, 4)]"
    )
    assert found[0] == [0, 5, 10, 15, 20] and found[1] == [-1, -0.5, 0, 0.5, 1]
    assert found[2] == pytest.approx([1e-7, 1e-5, 1e-3, 0.1]) and found[3] == [-1000, -100, -10, 0, 10]
    assert found[4] == [2, 3, 4, 5, 6, 7] and found[5] == [0.4, 0.401]


@pytest.mark.parametrize("kind", ["linear", "log", "symlog"])
def test_a_scale_leads_there_and_back(kind):
    low = 0.01 if kind == "log" else -500.0
    values = [low, 0.5, 7.0, 12.0, 900.0]
    make = f"R.scale('{kind}', [{low}, 900], [200, 20])"
    places, back = np.array(run(f"((s) => values.map((v) => [s.of(v), s.back(s.of(v))]))({make})", values=values)).T
    np.testing.assert_allclose(back, values, rtol=1e-9)
    assert places[0] == 200 and places[-1] == 20 and (np.diff(places) < 0).all()


def test_a_symmetric_logarithm_is_that_of_the_plain_figure():
    from matplotlib.scale import SymmetricalLogTransform

    values = [-500.0, -10.0, -3.0, 0.0, 8.0, 10.0, 60.0, 900.0]
    found = run("values.map(R.scale('symlog', [-500, 900], [0, 1]).of)", values=values)
    ours = SymmetricalLogTransform(10, 10, 1).transform(np.array(values))
    np.testing.assert_allclose(found, (ours - ours[0]) / (ours[-1] - ours[0]), atol=1e-12)


def test_numbers_are_written_as_people_read_them():
    found = run("[0.40613, -0.5, 0, 1e-7, -2.5e-5, 123456, NaN].map((v) => R.written(v))")
    assert found == ["0.4061", "\u22120.5", "0", "10\u207b\u2077", "\u22122.5\u00b710\u207b\u2075",
                     "1.235\u00b710\u2075", "none"]  # fmt: skip


def test_a_title_that_is_wider_than_its_panel_stands_on_a_line_of_its_own():
    """40 letters of 6 px have no room behind a label on 300 px, and do on 600."""
    given = steps()
    given["panels"][0]["title"] = "x" * 40
    narrow, wide = (run(f"R.render(given, R.START, {width})", given=given) for width in (300, 600))
    label, title = (re.search(rf'<text class="{name}" x="4" y="(\d+)"', narrow) for name in ("label", "title"))
    assert int(title[1]) - int(label[1]) == 14 and "<tspan class" not in narrow
    assert '<text class="title"' not in wide and f'<tspan class="title">{"x" * 40}</tspan>' in wide
    grown = [run(f"R.layout(given, R.START, {width}).height", given=given) for width in (300, 600)]
    assert grown[0] - grown[1] == 14  # one panel of several has such a title


def steps() -> dict:
    y = np.stack([np.sin(TIME), 0.5 * np.cos(TIME)], -1)
    return chart(tracking(TIME, 0 * y, {"a": y, "b <i>": 2 * y}, {"a": y, "b <i>": -y}, title="T"))


def test_every_curve_is_drawn_where_its_values_are():
    found = steps()
    element, layout = run("[R.render(c, R.START, 760), R.layout(c, R.START, 760)]", c=found)
    lines = outlines(element)
    assert len(lines) == 3 + 3 + 2 + 2 and "b &#60;i&#62;" not in element and "<i>" not in element
    box, (low, high, _) = layout["places"][0]["box"], found["panels"][0]["y"]
    x, y = np.array(lines[1]).T
    np.testing.assert_allclose(x, box["left"] + TIME / 20.2 * (box["right"] - box["left"]), atol=0.06)
    expected = box["bottom"] - (np.sin(TIME) - low) / (high - low) * (box["bottom"] - box["top"])
    np.testing.assert_allclose(y, expected, atol=0.12)
    assert element.count("time [s]") == 1


def test_a_held_input_is_drawn_in_steps():
    element = run("R.render(c)", c=steps())
    held = re.findall(r'<path d="(M[^"]*?H[^"]*)" stroke="#0072b2"', element)
    assert len(held) == 2 and all("L" not in path and path.count("H") == path.count("V") == 101 for path in held)


def test_a_series_that_is_switched_off_is_not_drawn_and_a_seed_is_on_demand():
    rows = np.array([[0.0, 1.0], [2.0, 5.0], [4.0, 90.0]])
    found = chart(average_rewards({"a": rows, "b": rows + 1}, [2, 4], window=1))
    states = [{"off": [], "seeds": [], "zoom": None}, {"off": ["a (3 seeds)"], "seeds": [], "zoom": None},
              {"off": ["a (3 seeds)"], "seeds": [2, 3], "zoom": None}]  # fmt: skip
    plain, one, compared = (outlines(run("R.render(c, s)", c=found, s=state)) for state in states)
    assert [len(lines) for lines in (plain, one, compared)] == [2, 1, 3]
    assert run("R.seeds(c)", c=found) == [1, 2, 3]
    read = run("R.values(c.panels[0], s, 3.9)", c=found, s=states[2])
    assert [(v["name"], v["x"], v["y"]) for v in read] == [
        ("b (3 seeds)", 4, pytest.approx(run("c.panels[0].lines[4].y[1]", c=found))),
        ("b (3 seeds), 2nd seed", 4, 6.0),
        ("b (3 seeds), 3rd seed", 4, 91.0),
    ]
    found["panels"][0]["y"][1] = 50.0
    high = [run("R.limits(c.panels[0], s)", c=found, s=state)[1] for state in states]
    assert high == [50.0, 50.0, 91.0]  # a seed that is switched on is not cut off


def test_a_part_of_the_time_is_shown_with_the_values_that_are_in_it():
    state = {"off": ["b <i>", "reference"], "seeds": [], "zoom": [0.0, 1.0]}
    low, high = run("R.limits(c.panels[0], s)", c=steps(), s=state)
    size = np.sin(1.0)
    assert (low, high) == (pytest.approx(-0.08 * size, abs=1e-3), pytest.approx(1.08 * size, abs=1e-3))
    ranges = run("R.layout(c, s, 760).places.map((p) => p.range)", c=steps(), s=state)
    assert ranges == [[0.0, 1.0]] * 4


def test_the_value_that_is_read_out_is_the_held_one_of_an_input_and_the_nearest_one_of_a_state():
    found = steps()
    state, held = (run("R.values(c.panels[k], R.START, 0.59)", c=found, k=k)[-1] for k in (1, 3))
    assert state["x"] == pytest.approx(0.6) and state["y"] == pytest.approx(np.cos(0.6), abs=1e-3)
    assert held["x"] == pytest.approx(0.4) and held["y"] == pytest.approx(-0.5 * np.cos(0.4), abs=1e-3)


def test_a_narrow_page_has_one_column_and_nothing_sticks_out():
    found = steps()
    found["columns"] = 2
    for width, columns in ((900, 2), (360, 1)):
        places = run("R.layout(c, R.START, w).places.map((p) => p.box)", c=found, w=width)
        assert len({box["left"] for box in places}) == columns
        assert all(0 < box["left"] < box["right"] < width for box in places)


BROWSER = """
const fs = require("fs"), vm = require("vm"), calls = {}, store = STORE;
const link = (hash) => ({ hash, current: false, toggleAttribute(name, on) { this.current = on; } });
const links = [link("#a"), link("#b"), link("#c")];
const section = (id, top) => ({ id, getBoundingClientRect: () => ({ top }) });
const sections = [section("a", -500), section("b", 90), section("c", 700)];
const element = (name) => ({ checked: true, addEventListener: (event, f) => { calls[name] = f; } });
const parts = { "#theme": element("theme"), nav: element("nav"), "#menu": element("menu") };
const root = { dataset: {} };
const world = {
  localStorage: store, innerWidth: 900, IntersectionObserver: class { observe() {} },
  matchMedia: () => ({ matches: DARK }),
  addEventListener: (event, f) => { calls[event] = f; },
  document: {
    documentElement: root, addEventListener: (event, f) => f(), querySelector: (name) => parts[name],
    querySelectorAll: (name) => ({ figure: [], "nav a": links, section: sections })[name],
  },
};
vm.runInNewContext(fs.readFileSync(CHART, "utf8") + fs.readFileSync(PAGE, "utf8"), world);
const before = root.dataset.theme || null;
calls.theme();
calls.nav();
const current = links.map((one) => one.current);
console.log(JSON.stringify([before, root.dataset.theme, store, current, parts["#menu"].checked]));
"""


@pytest.mark.parametrize(
    ("dark", "kept", "begins", "then"),
    [(False, {}, None, "dark"), (True, {}, None, "light"), (True, {"theme": "light"}, "light", "dark")],
)
def test_the_theme_follows_the_system_until_it_is_chosen_and_the_choice_is_kept(dark, kept, begins, then):
    places = {"CHART": HERE / "chart.js", "PAGE": HERE / "page.js"}
    names = {name: json.dumps(str(path)) for name, path in places.items()} | {"DARK": json.dumps(dark)}
    code = re.sub("|".join((*names, "STORE")), lambda found: (names | {"STORE": json.dumps(kept)})[found[0]], BROWSER)
    done = subprocess.run(["node", "-e", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    before, after, store, current, menu = json.loads(done.stdout)
    assert (before, after, store) == (begins, then, {"theme": then})
    assert current == [False, True, False] and menu is False  # the section that is read is marked, the menu closes
