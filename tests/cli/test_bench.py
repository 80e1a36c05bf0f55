from __future__ import annotations

import csv
from importlib import import_module
from pathlib import Path

import pytest
from matplotlib.image import imread

from nerfreg.bench import losses, quadrature
from nerfreg.cli import main
from nerfreg.cli.bench import BENCHES, parse_bench_options

FORMS = {
    ("depth_smoothness", "plugin"),
    ("distortion", "all pairs"),
    ("distortion", "plugin"),
    ("distortion", "prefix sums"),
    ("entropy", "+ 1e-10"),
    ("entropy", "1 - exp(-tau)"),
    ("entropy", "plugin"),
    ("full_geometry", "1 - sum w"),
    ("full_geometry", "plugin"),
    ("kl", "+ 1e-10"),
    ("kl", "plugin"),
    ("occlusion", "plugin"),
}


def bench(
    capsys: pytest.CaptureFixture[str], name: str, *words: str
) -> tuple[str, list[dict[str, str]], Path]:
    """What a bench prints, the lines of its CSV file, and the folder that the printed paths lie in."""
    assert main(["bench", name, "--quick", *words]) == 0
    out = capsys.readouterr().out
    paths = [Path(line) for line in out.splitlines()[-3:]]
    assert [path.name for path in paths] == [f"{name}.csv", f"{name}.png", f"{name}.svg"]
    assert imread(paths[1]).shape[1] >= 1200
    assert "<svg" in paths[2].read_text(encoding="utf-8")[:1000]
    with paths[0].open(encoding="utf-8", newline="") as file:
        return out, list(csv.DictReader(file)), paths[0].parent


def test_quadrature(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    out, points, folder = bench(capsys, "quadrature")
    assert folder == Path("bench", "quadrature")
    # 9 media, 4 samplers, 2 precisions.
    assert len(points) == 72 * len(quadrature.QUICK.samples)
    assert list(points[0])[:6] == [
        "medium",
        "sampler",
        "dtype",
        "samples",
        "evaluations",
        "microseconds",
    ]
    errors = [
        f"{quantity}_error{end}"
        for quantity in ("opacity", "depth", "color")
        for end in ("", "_p10", "_p90")
    ]
    assert list(points[0])[6:] == errors
    for point in points:
        assert float(point["microseconds"]) > 0
        assert all(float(point[error]) >= 0 for error in errors)
    assert "one thread" in " ".join(out.split())


def test_losses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, points, folder = bench(capsys, "losses", "-o", str(tmp_path / "elsewhere"))
    assert folder == tmp_path / "elsewhere"
    assert {(point["plugin"], point["form"]) for point in points} >= FORMS
    assert list(points[0]) == [
        "plugin", "form", "input", "samples", "relative_error", "milliseconds", "value", "exact", "exact_rays", "rays",
    ]  # fmt: skip
    own = [point for point in points if point["form"] == "plugin"]
    # 4 inputs for each of 6 plugins and each size.
    assert len([point for point in own if (point["plugin"], "plugin") in FORMS]) == 24 * len(
        losses.QUICK.samples
    )
    # What the issue promises for losses in float32.
    assert max(float(point["relative_error"]) for point in own) < 1e-5
    assert "one thread" in " ".join(out.split())
    # It renders again, and there is no field to do it with.
    assert "adversarial" in " ".join(out.split()).partition("exact values:")[2]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "bench needs a name first; known: quadrature, losses"),
        (["--quick"], "bench needs a name first"),
        (["quadratures"], "unknown bench 'quadratures'; did you mean 'quadrature'?"),
        (["losses", "--quik"], "bench: unknown option '--quik'; did you mean '--quick'?"),
        (["losses", "-o"], "-o needs a folder"),
        (["losses", "-o", "--quick"], "-o needs a folder"),
        (["losses", "train.rays=3"], "bench: unknown option 'train.rays=3'"),
        (["losses", "--steps", "3"], "bench: unknown option '--steps'"),
        (["stp"], "unknown bench 'stp'; did you mean 'step'?"),
        (["step", "--step", "3"], "bench: unknown option '--step'; did you mean '--steps'?"),
        (["step", "-m"], "bench: unknown option '-m'"),
        (["step", "--steps"], "--steps needs the number of steps to time"),
        (["step", "--steps", "--quick"], "--steps needs the number of steps to time"),
        (["step", "--steps", "0"], "--steps 0: must be a whole number, at least 1"),
        (["step", "--warmup", "1.5"], "--warmup 1.5: must be a whole number"),
        (["step", "--at", "1.5"], "--at 1.5: must be a share of the budget, 0 to 1"),
        (["step", "--at", "half"], "--at half: must be a share of the budget"),
        (["step", "--at", "nan"], "--at nan: must be a share of the budget"),
        (["overhead", "--only"], "--only needs names of plugins and presets"),
        (["render"], "bench render needs the folder of one run: nerfreg bench render RUN"),
        (["render", "a", "b"], "bench render needs the folder of one run"),
    ],
)
def test_refuses(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *words]) == 2
    assert message in capsys.readouterr().err


def test_refuses_a_file_as_folder_before_measuring(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "taken"
    file.touch()
    assert main(["bench", "losses", "-o", str(file)]) == 2
    assert f"-o {file}: is a file" in capsys.readouterr().err


def test_options() -> None:
    plain = parse_bench_options(["losses"])
    assert (plain.folder, plain.quick) == (Path("bench/losses"), False)
    given = parse_bench_options(["quadrature", "--quick", "-o", "out"])
    assert (given.name, given.folder, given.quick) == ("quadrature", Path("out"), True)
    assert list(BENCHES) == ["quadrature", "losses", "step", "overhead", "render", "scaling"]


def test_options_of_one_bench_and_words() -> None:
    step = parse_bench_options(
        ["step", "+reg=kl", "--at", "0.5", "~x", "--steps", "7", "train.rays=3", "--warmup", "2"]
    )
    assert step.words == ("+reg=kl", "~x", "train.rays=3")
    assert step.sizes == {"at": 0.5, "steps": 7, "warmup": 2}
    overhead = parse_bench_options(["overhead", "--only", "kl,lipschitz"])
    assert (overhead.words, overhead.sizes) == ((), {"only": ("kl", "lipschitz")})
    render = parse_bench_options(["render", "runs/a", "--views", "4"])
    assert (render.words, render.sizes) == (("runs/a",), {"views": 4})


def test_every_option_is_a_field_of_its_benchs_sizes() -> None:
    for entry in BENCHES.values():
        bench = import_module(entry.module)
        for sizes in (bench.FULL, bench.QUICK):
            assert {option.removeprefix("--") for option in entry.options} <= set(vars(sizes))
