"""The studio's command, started for a test, and asked as a browser would."""

import json
import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.cookiejar import CookieJar
from pathlib import Path
from typing import Any

_ADDRESS = re.compile(r"(http://127\.0\.0\.1:\d+)/\?token=(\S+)")


@dataclass
class Studio:
    """A running studio."""

    process: "subprocess.Popen[str]"
    root: str
    """http://127.0.0.1:PORT."""
    token: str

    @property
    def address(self) -> str:
        """What the command has printed."""
        return f"{self.root}/?token={self.token}"

    def browser(self, name: str = "") -> "Browser":
        """One that has been at the address."""
        found = Browser(self.root, name)
        found.ask(f"/?token={self.token}")
        return found


class Browser:
    """Asks with its cookies."""

    def __init__(self, root: str, name: str = "") -> None:
        self.root, self.name = root, name
        self._opener = urllib.request.build_opener(
            urllib.request.ProxyHandler({}), urllib.request.HTTPCookieProcessor(CookieJar())
        )

    def ask(
        self, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer; headers that are empty are not sent."""
        sent = {"X-Browser": self.name} if self.name else {}
        data = None
        if body is not None:
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
            sent |= {"Content-Type": "application/json", "Origin": self.root}
        sent = {name: value for name, value in (sent | (headers or {})).items() if value}
        request = urllib.request.Request(self.root + path, data, sent)
        try:
            with self._opener.open(request, timeout=60) as answer:
                return answer.status, dict(answer.headers), answer.read()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, dict(error.headers), error.read()

    def json(self, path: str, body: Any = None) -> Any:
        """The object of a good answer."""
        status, _, data = self.ask(path, body)
        found = json.loads(data)
        assert status == 200, data
        assert not (isinstance(found, dict) and "error" in found), found
        return found

    def refused(self, path: str, body: Any = None) -> str:
        """The sentence of a refusal."""
        status, _, data = self.ask(path, body)
        assert status == (200 if self.name else 400), (status, data[:300])
        sentence = json.loads(data)["error"]
        assert len(sentence.splitlines()) == 1
        return str(sentence)


@contextmanager
def studio(path: Path, *more: str) -> Iterator[Studio]:
    """Run `mgsgraph studio PATH`."""
    words = [sys.executable, "-W", "error", "-m", "mgsgraph", "studio", str(path), "--no-browser", *more]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = _ADDRESS.search(process.stdout.readline())
            if found is None:
                process.kill()
                raise AssertionError(process.communicate()[1])
            yield Studio(process, found[1], found[2])
        finally:
            process.kill()
