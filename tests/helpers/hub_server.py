"""A little Hugging Face Hub on this machine: as much of it as pushing and pulling a data set needs.

Files of `.parquet` go by Git LFS, all others within the commit, as on the real one.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections import Counter
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.parse import unquote, urlsplit

TOKEN = "hf_of_the_test"


class HubServer(ThreadingHTTPServer):
    """Keeps every commit of every data set: `commits[name]` is a list of files by path.

    Attributes:
      private: names that need a token.
      served, put: how often each file was sent, and received by Git LFS.
      fails_after: files that are sent before it breaks.
    """

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.commits: dict[str, list[dict[str, bytes]]] = {}
        self.large: dict[str, bytes] = {}
        self.private: set[str] = set()
        self.served: Counter[str] = Counter()
        self.put: Counter[str] = Counter()
        self.fails_after: int | None = None
        self.url = f"http://127.0.0.1:{self.server_address[1]}"

    def files(self, name: str) -> dict[str, bytes]:
        """The latest files of a data set."""
        return self.commits[name][-1]


@contextmanager
def hub_server():
    """A running server."""
    server = HubServer()
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def sha_of(name: str, number: int) -> str:
    """The hash of a commit."""
    return hashlib.sha1(f"{name} {number}".encode()).hexdigest()


class _Handler(BaseHTTPRequestHandler):
    server: HubServer
    protocol_version = "HTTP/1.1"

    def log_message(self, *args) -> None:
        pass

    def _send(self, body, status: int = 200, **headers: str) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for key, value in {"Content-Length": str(len(data)), **headers}.items():
            self.send_header(key.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def _refuse(self, status: int, code: str, message: str) -> None:
        self._send({"error": message}, status, X_Error_Code=code, X_Error_Message=message)

    def _has_token(self) -> bool:
        return self.headers.get("authorization") == f"Bearer {TOKEN}"

    def _state(self, name: str, revision: str):
        """The commit and its files; None where that was refused."""
        commits = self.server.commits.get(name)
        if commits is None or (name in self.server.private and not self._has_token()):
            self._refuse(404 if self._has_token() else 401, "RepoNotFound", "Repository not found")
            return None
        numbers = {sha_of(name, number): number for number in range(len(commits))} | {
            "main": len(commits) - 1
        }
        if revision not in numbers:
            self._refuse(404, "RevisionNotFound", f"Invalid rev id: {revision}")
            return None
        return sha_of(name, numbers[revision]), commits[numbers[revision]]

    def do_GET(self) -> None:
        path = unquote(urlsplit(self.path).path)
        if found := re.fullmatch(r"/api/datasets/([^/]+/[^/]+)(?:/revision/(.+))?", path):
            if state := self._state(found[1], found[2] or "main"):
                siblings = [{"rfilename": name} for name in state[1]]
                self._send({"id": found[1], "sha": state[0], "siblings": siblings})
        elif found := re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/tree/([^/]+)", path):
            if state := self._state(found[1], found[2]):
                self._send([self._entry(name, data) for name, data in state[1].items()])
        elif found := re.fullmatch(r"/datasets/([^/]+/[^/]+)/resolve/([^/]+)/(.+)", path):
            if state := self._state(found[1], found[2]):
                self._file(state[0], state[1], found[3])
        else:
            self._refuse(404, "", f"no GET {path}")

    do_HEAD = do_GET

    def _entry(self, name: str, data: bytes) -> dict:
        return {
            "type": "file",
            "path": name,
            "size": len(data),
            "oid": hashlib.sha1(data).hexdigest(),
        }

    def _file(self, commit: str, files: dict[str, bytes], name: str) -> None:
        if name not in files:
            self._refuse(404, "EntryNotFound", "Entry not found")
            return
        if self.command == "GET":
            if (
                self.server.fails_after is not None
                and sum(self.server.served.values()) >= self.server.fails_after
            ):
                self._refuse(400, "", "out of order")
                return
            self.server.served[name] += 1
        tag = hashlib.sha1(files[name]).hexdigest()
        self._send(files[name], ETag=f'"{tag}"', X_Repo_Commit=commit)

    def do_PUT(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        self.server.put[self.path] += 1
        self.server.large[self.path.split("/")[-1]] = data
        self._send({})

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        path = unquote(urlsplit(self.path).path)
        if not self._has_token() and path != "/api/validate-yaml":
            self._refuse(401, "", "Invalid username or password.")
        elif path == "/api/validate-yaml":
            self._send({"errors": [], "warnings": []})
        elif path == "/api/repos/create":
            asked = json.loads(body)
            self._create(f"{asked.get('organization') or 'me'}/{asked['name']}", asked)
        elif found := re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/preupload/main", path):
            files = json.loads(body)["files"]
            self._send({"files": [self._mode(each["path"]) for each in files]})
        elif re.fullmatch(r"/datasets/[^/]+/[^/]+\.git/info/lfs/objects/batch", path):
            self._send(
                {
                    "transfer": "basic",
                    "objects": [self._action(o) for o in json.loads(body)["objects"]],
                }
            )
        elif found := re.fullmatch(r"/api/datasets/([^/]+/[^/]+)/commit/main", path):
            self._commit(found[1], [json.loads(line) for line in body.splitlines()])
        else:
            self._refuse(404, "", f"no POST {path}")

    def _create(self, name: str, asked: dict) -> None:
        if name.startswith("other/"):
            self._refuse(
                403, "", "You don't have the rights to create a dataset under this namespace"
            )
            return
        if name in self.server.commits:
            url = f"{self.server.url}/datasets/{name}"
            self._send({"error": "You already created this dataset repo", "url": url}, 409)
            return
        self.server.commits[name] = [{".gitattributes": b"*.parquet filter=lfs\n"}]
        if asked.get("private") or asked.get("visibility") == "private":
            self.server.private.add(name)
        self._send({"url": f"{self.server.url}/datasets/{name}", "name": name})

    def _mode(self, name: str) -> dict:
        mode = "lfs" if name.endswith(".parquet") else "regular"
        return {"path": name, "uploadMode": mode, "shouldIgnore": False}

    def _action(self, asked: dict) -> dict:
        if asked["oid"] in self.server.large:
            return asked
        return asked | {
            "actions": {"upload": {"href": f"{self.server.url}/large/{asked['oid']}", "header": {}}}
        }

    def _commit(self, name: str, lines: list[dict]) -> None:
        files = dict(self.server.files(name))
        for line in lines:
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.server.large[value["oid"]]
            elif line["key"] == "deletedFile":
                del files[value["path"]]
        self.server.commits[name].append(files)
        number = len(self.server.commits[name]) - 1
        url = f"{self.server.url}/datasets/{name}/commit/{sha_of(name, number)}"
        self._send({"success": True, "commitUrl": url, "commitOid": sha_of(name, number)})
