"""Policies from and to the Hugging Face Hub.

No test asks the Hub: a stand-in on loopback answers the requests that huggingface_hub makes for a
download and for a commit of a regular and an LFS file. Xet storage and multipart are not tried.
"""

import base64
import hashlib
import json
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

pytest.importorskip("huggingface_hub")
from huggingface_hub import constants

from flipperctl import checkpoint
from flipperctl.checkpoint import hub
from flipperctl.errors import CheckpointError, MissingExtraError
from flipperctl.policies.source import load_policy
from tests.cli.call import call

GENERALIST = checkpoint.shipped_policies()["generalist"].read_bytes()
Files = dict[str, bytes]


class Hub(ThreadingHTTPServer):
    """Repositories by name; each revision but main is missing."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Requests)
        self.repositories: dict[str, Files] = {}
        self.stored: Files = {}  # of LFS, by SHA-256
        self.tokens: set[str | None] = set()
        self.address = f"http://127.0.0.1:{self.server_port}"

    def commit(self, name: str) -> str:
        files = sorted(self.repositories[name].items())
        return hashlib.sha1(repr(files).encode()).hexdigest()


class Requests(BaseHTTPRequestHandler):
    """The part of the Hub's API that is used."""

    server: Hub

    def log_message(self, *words: object) -> None:
        """Keep quiet."""

    def answer(self, body: object = b"", code: int = 200, **headers: str) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(code)
        for key, value in ({"Content-Length": str(len(data))} | headers).items():
            self.send_header(key.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def do_GET(self) -> None:
        parts = self.path.partition("?")[0].strip("/").split("/")
        api = parts[:2] == ["api", "models"]
        user, name, _, revision, *rest = (parts[2:] if api else parts) + [""] * 3
        files = self.server.repositories.get(f"{user}/{name}")
        if files is None:
            return self.answer(code=404, X_Error_Code="RepoNotFound")
        commit = self.server.commit(f"{user}/{name}")
        if revision not in ("main", commit):
            return self.answer(code=404, X_Error_Code="RevisionNotFound")
        if api:
            listed = [{"rfilename": n, "size": len(data)} for n, data in files.items()]
            return self.answer({"id": f"{user}/{name}", "sha": commit, "siblings": listed})
        data = files["/".join(filter(None, rest))]
        tag = hashlib.sha1(data).hexdigest()
        return self.answer(data, X_Repo_Commit=commit, ETag=f'"{tag}"')

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_PUT(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        assert hashlib.sha256(data).hexdigest() == self.path.rpartition("/")[2]
        self.server.stored[self.path.rpartition("/")[2]] = data
        self.answer()

    def do_POST(self) -> None:
        path = self.path.partition("?")[0]
        lines = self.rfile.read(int(self.headers["Content-Length"])).decode().splitlines()
        sent = [json.loads(line) for line in lines]
        self.server.tokens.add(self.headers["Authorization"])
        if path == "/api/validate-yaml":
            return self.answer({"errors": [], "warnings": []})
        if path == "/api/repos/create":
            name = f"{sent[0]['organization']}/{sent[0]['name']}"
            self.server.repositories.setdefault(name, {})
            return self.answer({"url": f"{self.server.address}/{name}"})
        if path.endswith("/preupload/main"):
            modes = {True: "lfs", False: "regular"}
            return self.answer({"files": [
                {"path": f["path"], "shouldIgnore": False,
                 "uploadMode": modes[f["path"].endswith(".safetensors")]}
                for f in sent[0]["files"]
            ]})  # fmt: skip
        if path.endswith("/info/lfs/objects/batch"):
            store = f"{self.server.address}/store"
            objects = [
                one | {"actions": {"upload": {"href": f"{store}/{one['oid']}"}}}
                for one in sent[0]["objects"]
            ]
            return self.answer({"transfer": "basic", "objects": objects})
        assert path.endswith("/commit/main"), path
        name = path.removeprefix("/api/models/").removesuffix("/commit/main")
        for line in sent:
            value = line["value"]
            if line["key"] == "file":
                content = base64.b64decode(value["content"])
                self.server.repositories[name][value["path"]] = content
            elif line["key"] == "lfsFile":
                self.server.repositories[name][value["path"]] = self.server.stored[value["oid"]]
        commit = self.server.commit(name)
        url = f"{self.server.address}/{name}/commit/{commit}"
        return self.answer({"commitUrl": url, "commitOid": commit, "success": True})


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hub]:
    with Hub() as server:
        Thread(target=server.serve_forever, daemon=True).start()
        template = server.address + "/{repo_id}/resolve/{revision}/{filename}"
        monkeypatch.setattr(constants, "ENDPOINT", server.address)
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
        monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "token"))
        monkeypatch.delenv("HF_TOKEN", raising=False)
        hub.download.cache_clear()
        yield server
        hub.download.cache_clear()
        server.shutdown()


@pytest.mark.parametrize("name", ["policy.safetensors", "best.safetensors"])
def test_a_policy_of_the_hub_is_judged_under_its_name(
    name: str, server: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.repositories["ann/stairs"] = {"README.md": b"", name: GENERALIST}
    asked = ("eval", "hf:ann/stairs", "terrain=flat", "--episodes", "1", "--baseline", "none")
    done = call(*asked, "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    assert json.loads(done.out)["scenes"][0]["controller"] == "hf:ann/stairs"
    commit = server.commit("ann/stairs")
    assert load_policy(f"hf:ann/stairs@{commit}").file.read_bytes() == GENERALIST
    # What was downloaded is used when the Hub cannot be asked.
    hub.download.cache_clear()
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    if name == hub.FILE:
        assert load_policy("hf:ann/stairs").label() == "hf:ann/stairs"


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("hf:ann", "write hf:user/name or hf:user/name@revision"),
        ("hf:ann/none", "the Hub has no such repository, or it is private"),
        ("hf:ann/two@v9", "the repository has no such revision"),
        ("hf:ann/two", "a single .safetensors file; it has a.safetensors, b.safetensors"),
        ("hf:ann/pickled", "a single .safetensors file; it has none"),
        ("hf:ann/large", "policy.safetensors has 0 MiB; at most 0 MiB are allowed"),
        ("hf:ann/broken", "policy.safetensors"),
    ],
)
def test_a_word_of_the_hub_that_names_no_policy(
    word: str, text: str, server: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hub, "LIMIT", 100)
    server.repositories |= {
        "ann/two": {"a.safetensors": b"", "b.safetensors": b""},
        "ann/pickled": {"policy.pt": b""},
        "ann/large": {"policy.safetensors": b"0" * 101},
        "ann/broken": {"policy.safetensors": b"no tensors"},
    }
    done = call("eval", word, "terrain=flat", "--episodes", "1", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert text in done.err


def test_without_network_or_extra_the_error_says_so(
    server: Hub, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(CheckpointError, match=r"^hf:ann/stairs: the Hub cannot be reached"):
        load_policy("hf:ann/stairs")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'flipperctl\[hub\]'"):
        load_policy("hf:ann/stairs")


@pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")  # huggingface_hub's own
def test_a_policy_and_its_card_are_uploaded_and_found_again(
    server: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ("card", "generalist", "--push", "ann/shared")
    done = call(*asked, cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "no token of the Hub is known" in done.err
    assert server.repositories == {}
    monkeypatch.setenv("HF_TOKEN", "hf_secret")
    done = call(*asked, cwd=tmp_path)
    assert done.code == 0, done.err
    assert "uploaded http" in done.err
    assert "hf_secret" not in done.err
    assert "Bearer hf_secret" in server.tokens
    files = server.repositories["ann/shared"]
    assert set(files) == {"policy.safetensors", "README.md"}
    assert files["README.md"].startswith(b"---\nlibrary_name: flipperctl\n")
    assert load_policy("hf:ann/shared").file.read_bytes() == GENERALIST
