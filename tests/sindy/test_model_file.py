"""A model survives its file to the last digit; a file that is damaged says so in one line."""

import json

import numpy as np
import pytest
import torch

from dynasindy.safe_io import DamagedFileError
from dynasindy.sindy import SindyModel
from dynasindy.sindy.covariance import Covariance
from dynasindy.sindy.library import Constraints, Library, parse
from dynasindy.sindy.model import FORMAT
from dynasindy.sindy.named_libraries import build_library
from dynasindy.systems import Tras, Xi


def coefficients(library: Library) -> torch.Tensor:
    generator = np.random.default_rng(0)
    size = 10.0 ** generator.uniform(-12, 12, (len(library), 6))
    return torch.from_numpy(np.where(generator.random(size.shape) < 0.3, size * generator.normal(size=size.shape), 0))


def save(library: Library, xi: torch.Tensor, path, **more) -> None:
    model = SindyModel(library.signature, library)
    model.set_coefficients(xi)
    for name, value in more.items():
        setattr(model, name, value)
    model.save(path)


@pytest.fixture
def written(tmp_path):
    library = build_library("paper_table", Xi().signature)
    save(library, coefficients(library), tmp_path / "model.json")
    return tmp_path / "model.json"


@pytest.mark.parametrize("name", ["rotor_reaction", "polynomial"])
def test_what_is_loaded_is_what_was_saved(tmp_path, name):
    library = build_library(name, Tras().signature)
    xi = coefficients(library)
    save(library, xi, tmp_path / "model.json")
    model = SindyModel.load(tmp_path / "model.json")
    again, back = model.library, model.coefficients
    assert again.names == library.names and again.signature == library.signature
    assert torch.equal(back, xi) and back.dtype == torch.float64


def test_a_file_can_be_read_by_a_person(written):
    data = json.loads(written.read_text())
    model = SindyModel.load(written)
    library, xi = model.library, model.coefficients
    assert data["format"] == FORMAT
    assert [line.partition("'")[0] for line in data["equations"]] == list(library.signature.state_names)
    assert data["signature"]["input_names"] == ["u_a", "u_p"]
    numbers = {(s, n): v for s, row in data["coefficients"].items() for n, v in row.items()}
    places = [(i, k) for i in range(6) for k in range(27) if xi[k, i]]
    states = library.signature.state_names
    assert numbers == {(states[i], library.names[k]): float(xi[k, i]) for i, k in places} and len(places) > 20


CALL = "__import__('os').system('touch canary')"


def name_state(name):
    def change(data):
        old = data["signature"]["state_names"][0]
        data["signature"]["state_names"][0] = name
        data["coefficients"][name] = data["coefficients"].pop(old)
        for factors in data["library"].values():
            for factor in factors:
                factor[0] = [name if variable == old else variable for variable in factor[0]]

    return change


def put(value, *path):
    def change(data):
        for step in path[:-1]:
            data = data[step]
        data[path[-1]] = value

    return change


HOSTILE = {
    "state with code": name_state(CALL),
    "state of two lines": name_state("a\nimport os"),
    "state that is a number": name_state("1"),
    "long state": name_state("x" * 1000),
    "too many states": put([f"s{k}" for k in range(100_000)], "signature", "state_names"),
    "unit with mathematics": put("$\\frac{", "signature", "state_units", 0),
    "range": put(float("inf"), "signature", "x_scale", 0),
    "function with code": put([[["u_p"], CALL, 1, 1.0]], "library", "u_p"),
    "two arguments of sin": put([[["u_p", "u_a"], "sin", 1, 1.0]], "library", "u_p"),
    "no argument": put([[[], "sin", 1, 1.0]], "library", "u_p"),
    "another variable": put([[["x'); import os; ('"], "sin", 1, 1.0]], "library", "u_p"),
    "power": put([[["u_p"], "id", 10**9, 1.0]], "library", "u_p"),
    "frequency": put([[["u_p"], "sin", 1, float("nan")]], "library", "u_p"),
    "first guess": put([[["u_p"], "tanh", 1, 1.0, float("inf")]], "library", "u_p"),
    "infinite coefficient": put(float("inf"), "coefficients", "omega_p", "u_p"),
    "word for a coefficient": put("1.0", "coefficients", "omega_p", "u_p"),
    "empty library": put({}, "library"),
    "many functions": put({str(k): [[["u_p"], "sin", 1, k + 0.5]] for k in range(20_000)}, "library"),
    "constraints": put({"alpha_a": {"free": [], "given": {"u_p": float("nan")}}}, "constraints"),
    "no row of a state": lambda data: data["coefficients"].pop("omega_p"),
    "negative delay": put(-0.01, "delay"),
    "delay that is no number": put(True, "delay"),
    "step that is no number": put(True, "step"),
    "settings of a fit": put({"method": CALL}, "refinement"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_model_of_a_stranger_is_numbers_and_registered_names_or_is_refused(written, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = json.loads(written.read_text())
    HOSTILE[name](data)
    written.write_text(json.dumps(data))
    with pytest.raises(ValueError) as error:  # noqa: PT011  the words differ from case to case
        SindyModel.load(written)
    assert "\n" not in str(error.value) and len(str(error.value)) < 2000
    assert not (tmp_path / "canary").exists()


def test_fitted_numbers_and_the_delay_come_back_to_the_last_digit(tmp_path):
    words = ["tanh(~7 Omega_a)", "Omega_p^2 per_cos2(~3 alpha_p)", "root(~0.1 alpha_a)", "tanh(7 Omega_a)"]
    library = Library(Xi().signature, map(parse, words)).with_shapes([5 + 1 / 3, 10 / 3, np.pi / 30])
    save(library, coefficients(library), tmp_path / "model.json", delay=0.1 / 3)
    model = SindyModel.load(tmp_path / "model.json")
    again, delay = model.library, model.delay
    assert again.features == library.features and delay == 0.1 / 3
    numbers = [(shape.frequency, shape.fitted) for shape in again.shapes]
    assert numbers == [(5 + 1 / 3, 7.0), (10 / 3, 3.0), (np.pi / 30, 0.1)]
    save(library, coefficients(library), tmp_path / "model.json")
    assert SindyModel.load(tmp_path / "model.json").delay == 0.0 and "delay" not in json.loads(
        (tmp_path / "model.json").read_text()
    )


def test_what_is_known_of_the_equations_comes_back(tmp_path):
    library = build_library("rotor", Tras().signature)
    constraints = Constraints.build(library, {"alpha_a": "Omega_a"}, {"omega_p": ["u_p"]}, {"Omega_p": {"u_a": -0.3}})
    save(library, coefficients(library), tmp_path / "model.json", constraints=constraints)
    back = SindyModel.load(tmp_path / "model.json").constraints
    assert torch.equal(back.free, constraints.free) and torch.equal(back.offset, constraints.offset)


def known_coefficients(columns: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    rng = np.random.default_rng(3)
    factor = rng.normal(size=(4, columns)) * np.array([[1e-9], [3.0], [1e6], [0.02]])
    return torch.tensor([2, 5, 2, 7]), torch.tensor([0, 0, 3, 3]), torch.from_numpy(factor)


@pytest.mark.parametrize("columns", [15, 2])
def test_the_covariance_of_coefficients_survives_its_file(tmp_path, columns):
    library, known = build_library("paper_table", Xi().signature), known_coefficients(columns)
    save(library, torch.ones(27, 6, dtype=torch.float64), tmp_path / "model.json", covariance=Covariance(*known))
    features, states, factor = SindyModel.load(tmp_path / "model.json").covariance
    assert torch.equal(features, known[0]) and torch.equal(states, known[1])
    size = known[2].norm(dim=-1)
    wanted = known[2] @ known[2].mT / size / size.unsqueeze(-1)
    np.testing.assert_allclose(factor @ factor.mT / size / size.unsqueeze(-1), wanted, atol=1e-13)
    told = json.loads((tmp_path / "model.json").read_text())["uncertainty"]["standard_errors"]
    assert told["alpha_a"][library.names[5]] == pytest.approx(float(size[1])) and told["alpha_p"] == {}


@pytest.mark.parametrize(
    "spoilt",
    [
        {"standard_errors": {}},
        {"standard_errors": {"alpha_a": {"1": -1.0}}, "correlation_factor": {"alpha_a": {"1": "1"}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": ""}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": "1 nan"}}},
        {"standard_errors": {"alpha_a": {"1": 1.0}}, "correlation_factor": {"alpha_a": {"1": "one"}}},
        [1.0],
    ],
)
def test_a_covariance_that_is_damaged_is_refused(written, spoilt):
    data = json.loads(written.read_text())
    if isinstance(spoilt, dict):
        spoilt = {what: {s: {} for s in data["coefficients"]} | words for what, words in spoilt.items()}
    written.write_text(json.dumps({**data, "uncertainty": spoilt}))
    with pytest.raises(DamagedFileError):
        SindyModel.load(written)
