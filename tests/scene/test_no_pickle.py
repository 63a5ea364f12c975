"""No pickle anywhere that reads a file somebody else made: a pickled file runs whatever code it likes."""

import ast
from pathlib import Path

import cluttergen_jax

ROOT = Path(cluttergen_jax.__file__).parent
REPOSITORY = ROOT.parent
_MODULES = {
    "pickle",
    "cPickle",
    "_pickle",
    "dill",
    "cloudpickle",
    "joblib",
    "shelve",
    "marshal",
    "pickletools",
}
_OFF = ast.Constant(value=False)
_CALLS = {"read_pickle", "to_pickle", "loads_pickle", "unpickle"}


def _files() -> list[Path]:
    programs = [*REPOSITORY.glob("*.py"), *(REPOSITORY / "examples").glob("*.py")]
    return [*sorted(ROOT.rglob("*.py")), *programs, *(REPOSITORY / "studies").rglob("*.py")]


def faults_of(text: str) -> list[str]:
    """What in a module's text could unpickle a file."""
    faults = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            faults += [a.name for a in node.names if _MODULES & set(a.name.split("."))]
        elif isinstance(node, ast.ImportFrom):
            faults += [node.module] if _MODULES & set((node.module or "").split(".")) else []
        elif isinstance(node, ast.Call):
            faults += _fault_of_call(node)
    return faults


def _fault_of_call(node: ast.Call) -> list[str]:
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    owner = getattr(getattr(node.func, "value", None), "id", "")
    keywords = {each.arg: each.value for each in node.keywords}
    if name in _CALLS:
        return [name]
    if owner in ("np", "numpy", "jnp") and name in ("load", "save"):
        # NumPy's own default has changed once already.
        return (
            []
            if _is_off(keywords.get("allow_pickle"))
            else [f"{owner}.{name} without allow_pickle=False"]
        )
    if owner == "torch" and name == "load":
        return ["torch.load"]
    return [] if _is_off(keywords.get("allow_pickle", _OFF)) else [f"{name} with allow_pickle"]


def _is_off(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Constant) and value.value is False


def test_nothing_can_unpickle_a_file():
    files = _files()
    assert len(files) > 100
    faults = {str(path.relative_to(REPOSITORY)): faults_of(path.read_text()) for path in files}
    # Work travels between the processes of a Ray cluster, never through a file.
    assert faults.pop("cluttergen_jax/cluster.py") == ["ray.cloudpickle"]
    # Questions to the process that reads strangers' files, and its answers, go through pipes.
    assert set(faults.pop("cluttergen_jax/importing/limited.py")) == {"pickle"}
    # What a part of a user's own holds is written to take its hash, and never read.
    assert faults.pop("cluttergen_jax/own_parts.py") == ["pickle"]
    assert not any(faults.values()), faults


def test_no_stored_file_is_a_pickle():
    # Nothing that is shipped needs one to be read either.
    suffixes = {".pkl", ".pickle", ".joblib", ".pt", ".pth"}
    stored = [*(REPOSITORY / "scenes").rglob("*"), *ROOT.rglob("*")]
    assert [path for path in stored if path.suffix in suffixes] == []
