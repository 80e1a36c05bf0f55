"""The command line: what it prints, refuses and leaves behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from nerfreg import __version__
from nerfreg.cli import launch, main
from nerfreg.cli.parser import make_parser, parsers_of
from nerfreg.cli.render_options import RenderOptions, parse_render_options
from nerfreg.errors import NerfregError, NerfregWarning
from nerfreg.runs.citations import cite

TINY = [
    "scene.size=8",
    "scene.views=2",
    "scene.test_views=1",
    "field.levels=2",
    "field.log2_entries=8",
]
SHORT = ["train.steps=2", "train.rays=8", "train.quiet=true", "eval.lpips=false", "eval.count=1"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test runs in an empty folder, and leaves the process as it was."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.setattr(sys, "argv", ["nerfreg"])
    return tmp_path


def test_help_lists_verbs_and_is_fast(environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "nerfreg", "--help"]
    begun = time.perf_counter()
    shown = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert time.perf_counter() - begun < 1
    assert all(f"\n    {verb} " in shown.stdout for verb in parsers_of(make_parser()))


@pytest.mark.parametrize("words", [[], ["-h"], ["--help"], ["--help", "--debug"]])
def test_help(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    assert capsys.readouterr().out.startswith("usage: nerfreg VERB")


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"nerfreg {__version__}\n"


@pytest.mark.parametrize("verb", [*parsers_of(make_parser()), "bench step"])
def test_help_of_a_verb(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*verb.split(), "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"usage: nerfreg {verb}")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["trian"], "unknown verb 'trian'; did you mean 'train'?"),
        (["train", "+reg=kll"], "unknown plugin or preset 'kll' in reg=kll; did you mean 'kl'?"),
        (
            ["train", "+reg=[kl,combinerff]"],
            "'combinerff' in reg=combinerff; did you mean 'combinerf'?",
        ),
        (
            ["train", "+reg=kl", "+reg=[entropy,lipschitz]"],
            "write one list: '+reg=[kl,entropy,lipschitz]'",
        ),
        (["train", "reg=kl"], "write +reg=kl"),
        (["train", "+reg=kl,entropy"], "write '+reg=[kl,entropy]' for a list, or -m to sweep"),
        (["train", "+reg=[kl"], "cannot read '+reg=[kl'"),
        (
            ["train", "+reg=kl", "reg.kl.weigth=1"],
            "unknown key 'reg.kl.weigth'; did you mean 'reg.kl.weight'?",
        ),
        (["train", "reg.kl.weight=1"], "reg.kl is not selected; add +reg=kl"),
        (["train", "reg.kll.weight=1"], "unknown plugin 'kll' in reg.kll; did you mean 'kl'?"),
        (["train", "field=5"], "unknown choice field=5; known: hash_grid, paper"),
        (["train", "-m", "optim=adam,true"], "unknown choice optim=true; known: adam, paper"),
        (["train", "scen=llff"], "unknown key 'scen'; did you mean 'scene'?"),
        (["train", "scene=lff"], "unknown choice scene=lff; did you mean 'llff'?"),
        (["train", "+foo=1"], "unknown key 'foo'"),
        (
            ["train", "+reg=kl", "reg.kl.weight=heavy"],
            "reg.kl.weight: 'heavy' is neither a number nor a schedule such as {schedule: linear,",
        ),
        (
            ["train", "+reg=kl", "reg.kl.weight=-1"],
            "reg.kl.weight=-1.0: must be finite and not negative",
        ),
        (["train", "eval.count=0"], "eval.count=0: must be at least 1"),
        (["train", "--config-dir", "nowhere"], "nowhere' not found"),
        (["train", "--config-name", "nowhere"], "no config file 'nowhere.yaml'"),
        (["train", "-m", "+reg=kl,kll"], "unknown plugin or preset 'kll'"),
        (["evaluate"], "evaluate needs the folder of a run"),
        (["evaluate", "nowhere"], "nowhere: not the folder of a run"),
        (["cite", "."], "not the folder of a run"),
        (["plugins", "kl"], "plugins takes no further argument, got 'kl'"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    words: list[str], message: str, elsewhere: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    last, *before = reversed(capfd.readouterr().err.splitlines())
    assert last.startswith("nerfreg: error: ")
    assert message in last
    assert not any("Traceback" in line or "Error" in line for line in before)
    assert not list(elsewhere.rglob("config.yaml"))


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "+reg=kll", "--debug"]) == 2
    error = capsys.readouterr().err
    assert "Traceback" in error and "MissingConfigException" in error


def test_error_in_the_middle_of_a_yaml_file_names_the_file(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (elsewhere / "conf" / "reg").mkdir(parents=True)
    (elsewhere / "conf" / "reg" / "mine.yaml").write_text(
        "defaults: [kl, _self_]\nkl: {wieght: 1}\n"
    )
    assert main(["train", "--cfg", "job", "+reg=mine"]) == 2
    assert (
        "in reg/mine.yaml: unknown key 'reg.kl.wieght'; did you mean 'reg.kl.weight'?"
        in capsys.readouterr().err
    )
    (elsewhere / "conf" / "reg" / "mine.yaml").write_text("kl: [\n")
    assert main(["train", "--cfg", "job", "+reg=mine"]) == 2
    assert "mine.yaml" in capsys.readouterr().err


def test_folder_that_cannot_be_written(elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (elsewhere / "file").touch()
    assert main(["train", "hydra.run.dir=file/run"]) == 2
    assert "nerfreg: error: cannot use file/run" in capsys.readouterr().err


def test_interrupt(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(launch, "train", interrupt)
    assert main(["train"]) == 130
    assert capsys.readouterr().err.splitlines() == ["nerfreg: interrupted"]


def test_a_warning_of_ours_is_one_line_and_shown_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def warn(*_: object) -> None:
        for text in ("a plugin does nothing", "a plugin does nothing", "another one"):
            warnings.warn(text, NerfregWarning, stacklevel=2)
        warnings.warn("of somebody else", UserWarning, stacklevel=1)

    monkeypatch.setattr(launch, "train", warn)
    shows = warnings.showwarning
    for _ in range(2):
        # A second run of the same process says it again. Others are left to Python.
        with pytest.warns(UserWarning, match="of somebody else") as others:
            warnings.simplefilter("default")
            assert main(["train"]) == 0
        assert [str(other.message) for other in others] == ["of somebody else"]
        assert capsys.readouterr().err.splitlines() == [
            "nerfreg: warning: a plugin does nothing",
            "nerfreg: warning: another one",
        ]
    assert warnings.showwarning is shows


def test_a_plugin_that_does_nothing_says_so(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Forward-facing photographs have no alpha.
    words = ["train", "+reg=silhouettes", "scene.layout=forward", *TINY, *SHORT]
    assert main(words) == 0
    lines = capsys.readouterr().err.splitlines()
    said = "nerfreg: warning: reg.silhouettes: does nothing: neither alpha nor masks"
    assert len([line for line in lines if line.startswith(said)]) == 1
    assert not any("NerfregWarning" in line for line in lines)


def test_refused_run_keeps_what_was_there(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(config: object, folder: Path) -> None:
        (folder / "metrics.jsonl").touch()
        raise NerfregError("too late")

    monkeypatch.setattr(launch, "train", refuse)
    assert main(["train", "hydra.run.dir=kept"]) == 2
    assert sorted(path.name for path in (elsewhere / "kept").iterdir()) == [
        ".hydra",
        "metrics.jsonl",
    ]


def test_composition_is_shown_without_running(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(["train", "--cfg", "job", "--package", "reg", "+reg=full_geometry", "--resolve"]) == 0
    )
    # 1e-3: the procedural scene is an orbit
    assert "full_geometry:\n  weight: 0.001\n" in capsys.readouterr().out
    assert list(elsewhere.iterdir()) == []


def test_training_leaves_a_run_that_can_be_cited_and_scored(
    elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "+reg=[kl,distortion]", *TINY, *SHORT]) == 0
    [run] = (elsewhere / "runs").glob("*/*")
    assert run.name.endswith("_procedural_kl+distortion")
    results = json.loads((run / "results.json").read_text(encoding="utf-8"))
    assert (results["step"], sorted(results["regularizers"])) == (2, ["distortion", "kl"])
    capsys.readouterr()
    assert main(["cite", str(run)]) == 0
    bibliography = capsys.readouterr().out
    keys = [
        line.partition("{")[2].rstrip(",")
        for line in bibliography.splitlines()
        if line.startswith("@")
    ]
    assert keys[:3] == ["mildenhall2020nerf", "muller2022instant", "kingma2015adam"]
    assert {"kim2022infonerf", "barron2022mipnerf360"} <= {*keys}
    assert len(keys) == len({*keys})  # combinerf is the source of both plugins, and listed once
    assert main(["evaluate", str(run), "eval.lpips=false"]) == 0
    again = json.loads((run / "results.json").read_text(encoding="utf-8"))
    assert again["psnr"] == pytest.approx(results["psnr"], rel=1e-5)
    assert main(["evaluate", str(run), "eval.lpipz=false"]) == 2


def test_sweep_leaves_a_folder_for_each(elsewhere: Path) -> None:
    assert (
        main(
            [
                "train",
                "-m",
                "+reg=[full_geometry],[full_geometry,distortion]",
                "seed=0,1",
                *TINY,
                *SHORT,
            ]
        )
        == 0
    )
    runs = sorted(
        ",".join(p.parent.name.split(",")[:2])
        for p in elsewhere.glob("multirun/procedural/*/results.json")
    )
    names = ("reg=full_geometry+distortion", "reg=full_geometry")
    assert runs == [f"{name},seed={seed}" for name in names for seed in (0, 1)]


def test_scene_draws_its_cameras(elsewhere: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", *TINY]) == 0
    [picture] = elsewhere.glob("runs/*/*/cameras.png")
    assert capsys.readouterr().out.splitlines()[-1] == str(picture)


def complete(line: str, environment: dict[str, str]) -> list[str]:
    """What a shell is told, which asks as argcomplete has it ask."""
    asked = {
        **environment,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": "completions",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    # argcomplete ends the process without the interpreter's own way out, exit code 0
    subprocess.run([sys.executable, "-m", "nerfreg"], env=asked, check=True)
    return Path("completions").read_text(encoding="utf-8").split("\n")


def test_completion(environment: dict[str, str]) -> None:
    assert set(complete("nerfreg ", environment)) == set(parsers_of(make_parser()))
    assert complete("nerfreg tr", environment) == ["train"]
    assert complete("nerfreg prune --bu", environment) == ["--budget"]
    assert complete("nerfreg bench st", environment) == ["step"]
    assert complete("nerfreg check lip", environment) == ["lipschitz"]


def test_completion_of_overrides(environment: dict[str, str]) -> None:
    assert {"+reg=kl", "+reg=combinerf"} <= {*complete("nerfreg train +reg=", environment)}
    assert complete("nerfreg train +reg=lip", environment) == ["+reg=lipschitz"]
    assert complete("nerfreg train +reg=kl@far reg.far.we", environment) == ["reg.far.weight="]
    choices = ["reg.far.density=weights", "reg.far.density=alphas"]
    assert complete("nerfreg train +reg=[entropy,kl@far] reg.far.density=", environment) == choices
    assert complete("nerfreg train +reg=combinerf reg.kl.density=a", environment) == [
        "reg.kl.density=alphas"
    ]
    assert complete("nerfreg train +reg=kl reg.kl.wei", environment) == ["reg.kl.weight="]
    assert sorted(complete("nerfreg scene scene=", environment)) == [
        f"scene={name}" for name in ("blender", "llff", "procedural", "transforms")
    ]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_for_the_program(
    shell: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["-sc", f"install={shell}"]) == 0
    code = capsys.readouterr().out
    assert "nerfreg" in code and ("complete" in code or "compdef" in code)


def test_completion_of_an_unknown_shell(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["-sc", "install=fsh"]) == 2
    assert "-sc install=fsh: did you mean 'fish'?" in capsys.readouterr().err


def test_render_options() -> None:
    assert parse_render_options([]) == RenderOptions("test", 60, 30.0, "gif", None)
    assert parse_render_options(["path=orbit", "frames=7", "out=a"]) == RenderOptions(
        "orbit", 7, 30.0, "gif", "a"
    )


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("path=orbti", "path=orbti: did you mean 'orbit'?"),
        ("frames=many", "frames: Value 'many'"),
        ("frames=0", "frames=0"),
        ("frame=7", "unknown option 'frame'; did you mean 'frames'?"),
        ("orbit", "'orbit' is no option of render"),
    ],
)
def test_bad_render_options(word: str, message: str) -> None:
    with pytest.raises(NerfregError) as caught:
        parse_render_options([word])
    assert message in str(caught.value)


def test_citing_a_run_with_a_plugin_that_is_gone(elsewhere: Path) -> None:
    (elsewhere / ".hydra").mkdir()
    (elsewhere / ".hydra" / "config.yaml").write_text("reg: {gone: {weight: 1}}\n")
    with pytest.raises(NerfregError, match=r"reg\.gone is not installed here"):
        cite(elsewhere)


def test_broken_pipe_is_quiet(environment: dict[str, str]) -> None:
    command = [sys.executable, "-m", "nerfreg", "plugins"]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        command, env=environment, stdout=writer, stderr=subprocess.PIPE, text=True
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (141, "")
