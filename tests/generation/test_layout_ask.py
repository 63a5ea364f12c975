"""A layout from a sentence: models that answer badly, well, never or too late; an endpoint on localhost."""

import http.server
import json
import sys
import threading
import time

import pytest
import yaml

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.generation.layout_ask import ModelError, layout_in, model_of
from cluttergen_jax.generation.layouts import asked_of, read_layout

GOOD = "title: Breakfast\nobjects: {mine: dinner_plate, my_mug: mug}\nrelations: [my_mug behind mine]\n"
ANSWERS = [
    "Here you are:\n```yaml\nobjects: {mine: plate, my_mug: mugg}\nrelations: [my_mug besides mine]\n```",
    '{"objects": {"mine": "dinner_plate", "my_mug": "mug"}, "relations": ["my_mugs behind mine"]}',
    f"<think>objects: {{}}</think>\nNow right:\n```\n{GOOD}```\nEnjoy!",
]
STUB = """
import json, sys
from pathlib import Path
prompt = sys.stdin.read()
seen = Path({seen!r})
prompts = json.loads(seen.read_text()) if seen.exists() else []
seen.write_text(json.dumps([*prompts, prompt]))
print(json.loads({answers!r})[len(prompts)])
"""


@pytest.fixture
def stub(tmp_path):
    """A command that answers badly twice and well the third time, and keeps what it was asked."""
    path = tmp_path / "stub.py"
    path.write_text(STUB.format(seen=str(tmp_path / "seen.json"), answers=json.dumps(ANSWERS)))
    return f"{sys.executable} {path}"


def test_a_command_is_told_its_errors_until_its_layout_is_sound(stub, tmp_path):
    said = []
    found = cg.ask_layout(
        "breakfast  for two", stub, tmp_path / "meal.yaml", pool="dining", show=said.append
    )
    assert said == ["asked 1 of 5: 3 errors", "asked 2 of 5: 1 error", "asked 3 of 5: sound"]
    assert found.spec == read_layout(tmp_path / "meal.yaml")
    written = yaml.safe_load((tmp_path / "meal.yaml").read_text())
    assert written["relations"] == ["my_mug behind mine"]
    assert written["pool"] == "dining"
    assert asked_of(tmp_path / "meal.yaml") == {
        "request": "breakfast for two",
        "model": f"{sys.executable.rpartition('/')[2]} stub.py",
        "tries": 3,
    }
    first, second, third = json.loads((tmp_path / "seen.json").read_text())
    assert '"relations"' in first
    assert "dinner_plate: dinner plate, 26 x 25 x 2" in first
    assert "The request: breakfast for two" in first
    assert "objects.my_mug: 'mugg'" in second
    assert "Did you mean 'mug'?" in second
    assert ANSWERS[0] in second
    assert "relations[0]: 'my_mugs' in a relation" in third
    log = json.loads((tmp_path / "meal.answers.json").read_text())
    assert [each["answer"].strip() for each in log["answers"]] == ANSWERS
    assert [len(each["errors"]) for each in log["answers"]] == [3, 1, 0]
    assert log["prompt"] == first


def test_a_layout_that_is_there_is_taken_and_another_is_not_replaced(stub, tmp_path):
    path = tmp_path / "meal.yaml"
    first = cg.ask_layout("breakfast", stub, path, pool="dining", show=lambda text: None)
    said = []
    again = cg.ask_layout("breakfast", stub, path, pool="dining", show=said.append)
    assert (again.text, again.spec, again.asked) == (first.text, first.spec, first.asked)
    assert len(said) == 1
    for request, options in (("supper", {}), ("breakfast", {"pool": "office"})):
        with pytest.raises(ConfigError, match="exists, with a layout of its own"):
            cg.ask_layout(request, stub, path, **{"pool": "dining", **options})
    (tmp_path / "seen.json").unlink()
    cg.ask_layout("supper", stub, path, pool="dining", overwrite=True, show=lambda text: None)
    assert asked_of(path)["request"] == "supper"


def test_a_function_may_be_the_model():
    prompts = []

    def model(prompt):
        prompts.append(prompt)
        return GOOD

    found = cg.ask_layout("breakfast", model, pool="dining", support="tray", show=prompts.append)
    assert found.asked.model == "model"
    assert found.path is None
    assert found.spec.support == "tray"
    assert prompts[1:] == ["asked 1 of 5: sound"]
    # What is decided is no field that the model has to fill.
    assert '"support": {"description"' not in prompts[0]
    assert "tray: 0.45 x 0.32" in prompts[0]


def test_what_is_decided_may_not_be_answered_otherwise():
    answers = iter([f"{GOOD}support: table\n", GOOD])
    said = []
    found = cg.ask_layout(
        "breakfast", lambda prompt: next(answers), pool="dining", support="tray", show=said.append
    )
    assert said == ["asked 1 of 5: 1 error", "asked 2 of 5: sound"]
    assert found.answers[0].faults[0].path == "support"


def test_one_that_never_answers_well_ends_with_its_last_errors(tmp_path):
    with pytest.raises(ModelError) as caught:
        cg.ask_layout(
            "breakfast",
            lambda prompt: "objects: {a: mugg}",
            tmp_path / "meal.yaml",
            pool="dining",
            show=lambda text: None,
        )
    said = str(caught.value)
    assert "in 5 answers" in said
    assert "objects.a: 'mugg'" in said
    assert "meal.answers.json" in said
    assert len(json.loads((tmp_path / "meal.answers.json").read_text())["answers"]) == 5
    assert [path.name for path in tmp_path.iterdir()] == ["meal.answers.json"]


@pytest.mark.parametrize(
    "answer", ["", "  \n", "I cannot do that.", "```yaml\n```", "- a\n- b", "{"]
)
def test_an_answer_without_a_layout_is_a_fault(answer):
    answers = iter([answer, GOOD])
    found = cg.ask_layout(
        "a meal", lambda prompt: next(answers), pool="dining", show=lambda text: None
    )
    assert len(found.answers[0].faults) == 1


@pytest.mark.parametrize(
    "answer",
    [
        GOOD,
        f"```yaml\n{GOOD}```",
        f"```\n{GOOD}```\n",
        f"~~~ yml\n{GOOD}~~~",
        f"Sure!\n\n  ```yaml\n{GOOD}  ```\nI put the mug behind.",
        f"First thought:\n```yaml\nnothing\n```\nBetter:\n```yaml\n{GOOD}```",
        f"Here it is:\n{GOOD}",
        f"<think>\n```yaml\nobjects: {{}}\n```\n</think>\n{GOOD}",
        GOOD.replace("\n", "\r\n"),
    ],
)
def test_the_layout_in_an_answer_is_found(answer):
    assert yaml.safe_load(layout_in(answer)) == yaml.safe_load(GOOD)


# Commands that fail


def command(tmp_path, code):
    path = tmp_path / "model.py"
    path.write_text(code)
    return f"{sys.executable} {path}"


def test_a_command_that_fails_shows_what_it_said(tmp_path):
    model = command(tmp_path, "import sys; print('no credit left', file=sys.stderr); sys.exit(1)")
    with pytest.raises(ModelError, match="status 1: no credit left"):
        cg.ask_layout("a meal", model, tmp_path / "meal.yaml", pool="dining")
    assert [path.name for path in tmp_path.iterdir()] == ["model.py"]


def test_a_command_that_hangs_is_ended_with_all_that_it_started(tmp_path):
    alive = tmp_path / "alive"
    child = f"import time\nwhile True: open({str(alive)!r}, 'w').close(); time.sleep(0.05)"
    code = f"import subprocess, sys, time\nsubprocess.Popen([sys.executable, '-c', {child!r}])\n"
    with pytest.raises(ModelError, match="no answer within 4 s"):
        cg.ask_layout(
            "a meal", command(tmp_path, f"{code}time.sleep(1000)"), pool="dining", timeout=4
        )
    alive.unlink()
    time.sleep(0.5)
    assert not alive.exists()


def test_a_function_that_hangs_is_not_waited_for():
    with pytest.raises(ModelError, match=r"no answer within 0.3 s"):
        cg.ask_layout("a meal", lambda prompt: time.sleep(60), pool="dining", timeout=0.3)


def test_a_command_that_prints_without_end_is_ended(tmp_path):
    model = command(tmp_path, "while True: print('x' * 10000)")
    with pytest.raises(ModelError, match="more than 1,048,576 bytes"):
        cg.ask_layout("a meal", model, pool="dining", timeout=60)


@pytest.mark.parametrize(
    ("model", "options", "said"),
    [
        ("no_such_command_at_all", {}, "No such file"),
        ("", {}, "a URL, a command"),
        ("'unclosed", {}, "No closing quotation"),
        (3, {}, "a URL, a command"),
        ("ftp://localhost", {}, "http:// or https://"),
        ("http://user:pass@localhost/v1", {}, "no user or password"),
        ("http://localhost/v1", {"key_env": "NO_SUCH_KEY"}, "a variable that is not set"),
        ("true", {"key_env": "HOME"}, "for a command"),
        ("true", {"max_tries": 6}, "1 to 5"),
        ("true", {"timeout": 0}, "more than 0"),
        ("true", {"relations": ["a on b"]}, "which the layout says"),
        ("true", {"out": "meal.txt"}, "a YAML file"),
    ],
)
def test_what_cannot_be_asked_is_refused(model, options, said):
    with pytest.raises(ConfigError, match=said):
        cg.ask_layout("a meal", model, **{"pool": "dining", **options})


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("/opt/bin/llm -m secret", "llm"),
        ("ollama run llama", "ollama run llama"),
        ("http://localhost:8000/v1", "localhost:8000"),
    ],
)
def test_a_model_is_recorded_without_what_may_be_secret(given, name):
    assert model_of(given, "", "", 1.0)[1] == name
    assert model_of(given, "mine", "", 1.0)[1] == "mine"


# An endpoint


class Endpoint(http.server.BaseHTTPRequestHandler):
    """Answers as the usual chat form does, what `reply` of its server says."""

    def do_POST(self):
        data = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.seen.append((self.path, dict(self.headers), json.loads(data)))
        status, body, headers = self.server.reply(len(self.server.seen) - 1)
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args):
        pass


@pytest.fixture
def endpoint():
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Endpoint)
    server.seen = []
    server.url = f"http://127.0.0.1:{server.server_port}/v1"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def chat(text):
    return json.dumps({"choices": [{"message": {"role": "assistant", "content": text}}]}).encode()


def test_an_endpoint_is_asked_in_the_usual_form(endpoint, monkeypatch):
    monkeypatch.setenv("MY_KEY", "abc123")
    endpoint.reply = lambda number: (200, chat(ANSWERS[number]), {})
    found = cg.ask_layout(
        "breakfast",
        endpoint.url,
        pool="dining",
        model_name="small-model",
        key_env="MY_KEY",
        show=lambda text: None,
    )
    assert (found.asked.model, found.asked.tries) == ("small-model", 3)
    assert [path for path, _, _ in endpoint.seen] == ["/v1/chat/completions"] * 3
    for _, headers, question in endpoint.seen:
        assert headers["Authorization"] == "Bearer abc123"
        assert question["model"] == "small-model"
        assert [each["role"] for each in question["messages"]] == ["user"]
    assert "Did you mean 'mug'?" in endpoint.seen[1][2]["messages"][0]["content"]
    assert "abc123" not in found.text


@pytest.mark.parametrize(
    ("reply", "said"),
    [
        ((401, b'{"error": "bad key abc123"}', {}), "status 401: .*bad key ..."),
        ((500, b"", {}), "status 500"),
        ((302, b"", {"Location": "http://127.0.0.1:9/"}), "status 302"),
        ((200, b"<html>", {}), "no choices"),
        ((200, b'{"choices": []}', {}), "no choices"),
        ((200, b"[" * 100_000, {}), "no choices"),
    ],
)
def test_an_endpoint_that_fails_is_told_without_the_key(endpoint, monkeypatch, reply, said):
    monkeypatch.setenv("MY_KEY", "abc123")
    endpoint.reply = lambda number: reply
    with pytest.raises(ModelError, match=said) as caught:
        cg.ask_layout("a meal", endpoint.url, pool="dining", key_env="MY_KEY")
    assert "abc123" not in str(caught.value)
    assert len(endpoint.seen) == 1


def test_an_endpoint_that_hangs_or_is_not_there_is_told(endpoint):
    endpoint.reply = lambda number: time.sleep(5) or (200, b"", {})
    with pytest.raises(ModelError, match=r"no answer within 0.3 s|timed out"):
        cg.ask_layout("a meal", endpoint.url, pool="dining", timeout=0.3)
    with pytest.raises(ModelError, match="refused"):
        cg.ask_layout("a meal", "http://127.0.0.1:9/v1", pool="dining", timeout=5)
