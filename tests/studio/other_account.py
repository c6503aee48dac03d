"""What another account of this machine tries with a running studio; run as that account by test_access.py."""

import json
import re
import sys
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path


def attack(ports: list[int], files: list[str], paths: list[str], cookie: str) -> dict[str, object]:
    """What it reads of processes and files, and [path, status, body] of each answer of the ports."""
    seen, read, answers = list[str](), list[str](), list[tuple[str, int, str]]()
    for process in Path("/proc").glob("[0-9]*"):
        for name in ("cmdline", "environ"):
            with suppress(OSError):
                seen.append((process / name).read_bytes().decode(errors="replace"))
    for file in map(Path, files):
        with suppress(OSError):
            read += [str(one) for one in file.iterdir()] if file.is_dir() else [file.read_text(encoding="utf-8")]
    tokens = {found for text in seen for found in re.findall(r"token=([-\w]+)", text)}
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    for root in (f"http://127.0.0.1:{port}" for port in ports):
        for path in (*paths, *(f"/?token={token}" for token in tokens)):
            many: list[dict[str, str]] = [{}, {"Origin": root}, {"Host": "localhost"}]
            if cookie and path.startswith("/api"):  # which shows the empty page, without a secret
                many.append({"Origin": root, "Cookie": cookie})
            for headers in many:
                for data in (None, b"{}"):
                    try:
                        with opener.open(urllib.request.Request(root + path, data, headers), timeout=60) as answer:
                            answers.append((path, answer.status, answer.read().decode(errors="replace")))
                    except urllib.error.HTTPError as error:
                        answers.append((path, error.code, error.read().decode(errors="replace")))
    return {"seen": seen, "read": read, "answers": answers}


if __name__ == "__main__":
    print(json.dumps(attack(**json.load(sys.stdin))))
