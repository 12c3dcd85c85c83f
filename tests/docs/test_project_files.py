"""Files by which others cite, build and join the project: they can be read, and say what is so."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import twc_env

yaml = pytest.importorskip("yaml", reason="needs PyYAML, which comes with the extra 'docs'")
ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FORMS = sorted(path for path in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml")
KINDS = {"markdown", "textarea", "input", "dropdown", "checkboxes"}
"""Of the elements of an issue form."""


def test_the_citation_has_what_its_format_requires_and_the_version_of_the_package():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["cff-version"] == "1.2.0" and citation["type"] == "software"
    assert citation["version"] == twc_env.__version__ and citation["license"] == PROJECT["license"]
    for source in [citation, *citation["references"]]:
        assert source["title"] and source["authors"]
        assert all("name" in a or {"family-names", "given-names"} <= a.keys() for a in source["authors"])
    assert all({"type", "title", "authors", "identifiers"} <= source.keys() for source in citation["references"])


@pytest.mark.parametrize("path", sorted((ROOT / ".github/workflows").glob("*.yml")), ids=lambda path: path.name)
def test_every_job_of_a_workflow_has_a_machine_and_steps_that_do_something(path):
    workflow = yaml.safe_load(path.read_text())
    assert {"pull_request", "push"} <= workflow[True].keys()  # YAML reads the key `on` as true
    for job in workflow["jobs"].values():
        assert job["runs-on"] and job["steps"][0]["uses"].startswith("actions/checkout@")
        assert all(("run" in step) != ("uses" in step) for step in job["steps"])
        for step in job["steps"]:
            for target in re.findall(r"^make (\w+)", step.get("run", ""), re.MULTILINE):
                assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE), target


def test_the_workflows_cover_every_python_of_the_classifiers_on_three_systems():
    job = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())["jobs"]["tests"]
    matrix = job["strategy"]["matrix"]
    assert matrix["os"] == ["ubuntu-latest", "macos-latest", "windows-latest"]
    claimed = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)}
    assert claimed <= set(matrix["python"]) and set(matrix["python"]) == {"3.11", "3.12", "3.13", "3.14"}


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.name)
def test_an_issue_form_asks_something(path):
    form = yaml.safe_load(path.read_text())
    assert {"name", "description", "body"} <= form.keys()
    asked = [element for element in form["body"] if element["type"] != "markdown"]
    assert {element["type"] for element in form["body"]} <= KINDS and asked
    assert all(element["attributes"]["label"] for element in asked)
    assert len({element["id"] for element in asked}) == len(asked)


def test_the_image_runs_the_command_as_a_user_without_rights_and_with_compiled_kernels():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    stages = [k for k, line in enumerate(lines) if line.startswith("FROM ")]
    last = lines[stages[-1] :]
    user = last.index("USER robot")
    assert any(line.startswith("RUN twc-env warm-up") for line in last[user:])
    assert 'ENTRYPOINT ["twc-env"]' in last
    extras = re.search(r"^ARG EXTRAS=(\w+)$", "\n".join(last), re.MULTILINE)
    assert extras is not None and extras[1] in PROJECT["optional-dependencies"]
    for source in re.findall(r"^COPY (?!--from)(.+) \S+$", "\n".join(lines), re.MULTILINE):
        assert all((ROOT / name).exists() for name in source.split())


def test_without_make_the_same_targets_are_built_with_the_same_extras():
    code = "import make, json; print(json.dumps([make.TARGETS, make.OPTIONAL]))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    targets, optional = json.loads(done.stdout)
    makefile = re.sub(r"\\\n\s*", "", (ROOT / "Makefile").read_text())
    make_pins = ("-c", "constraints.txt")
    known = set(re.findall(r"^([a-z-]+):.*##", makefile, re.MULTILINE))
    assert known - set(targets) == {"help", "coverage", "clean"} and set(targets) <= known
    asked = subprocess.run([sys.executable, "make.py"], cwd=ROOT, capture_output=True, text=True).stdout
    assert set(re.findall(r"make\.py (\S+)", asked)) == set(targets) and "but `coverage` and `clean`" in asked
    for target, (mark, packages, commands) in targets.items():
        rule = re.search(rf"^{re.escape(mark)}:.*?(?=^\S)", makefile, re.DOTALL | re.MULTILINE)
        assert rule is not None and re.search(rf"^{target}: .*{re.escape(mark)}", makefile, re.MULTILINE)
        assert all(package in rule[0] for package in packages if package not in make_pins), target
        recipe = re.search(rf"^{target}:.*?(?=^\S)", makefile[rule.end() :], re.DOTALL | re.MULTILINE)
        assert recipe is not None
        ours = [command[2:] if command[1] == "twc_env" else command for command in commands]
        theirs = re.findall(r"^\t(?:\w+=\S+ )*(?:\$\(PY\)|\.venv\S*/bin/\S+) (.+)$", recipe[0], re.MULTILINE)
        assert [shlex.split(words) for words in theirs] == ours
        tried = re.findall(r"\$\(INSTALL\) (.+?) \|\| echo \"(.+?)\"", rule[0])
        others = [(" ".join(packages[2:]), names) for packages, names in optional.get(mark, [])]
        assert [words.replace("'", "") for words, _ in tried] == [words for words, _ in others]
        assert all(said.startswith(names) for (_, said), (_, names) in zip(tried, others, strict=True))


def test_without_make_the_repository_of_the_docs_is_an_option():
    code = (
        "import make, os; make.run = lambda *_: print(os.environ['GITHUB_REPOSITORY']) or 1;"
        "make.main(['docs', '--repository', 'some-one/twc.env'])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert "some-one/twc.env" in done.stdout.splitlines()


def test_without_make_an_unknown_target_prints_the_manual():
    done = subprocess.run([sys.executable, "make.py", "cake"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and "make.py demo" in done.stdout


def test_installing_shows_the_errors_of_pip_and_no_warnings_about_the_machine():
    text = (ROOT / "Makefile").read_text() + re.sub(r'", "', " ", (ROOT / "make.py").read_text())
    calls = re.findall(r"-m pip install (\S+)", text)
    assert len(calls) == 4 and set(calls) == {"-qq"}
    given = ["--dry-run", "--no-index", "--find-links", "/no/such/folder", "no-such-package-of-anybody"]
    done = subprocess.run([sys.executable, "-m", "pip", "install", *calls[:1], *given], capture_output=True, text=True)
    told = (done.stdout + done.stderr).splitlines()
    assert done.returncode and told and all(line.startswith("ERROR: ") for line in told), told
