"""A simulated archive served over HTTP from this machine: listings and parts of files (Range), as the real ones do."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

_RANGE = re.compile(r"bytes=(\d+)-(\d*)")
"""The one kind of range that is asked for: from a byte on, to another one or to the end."""


@contextmanager
def serving(folder: Path) -> Iterator[str]:
    """Serve a folder on a free port of localhost; the address, for ``mgsgraph fetch --mirror``."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Handler, directory=str(folder))) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


class _Handler(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        """A listing, a file, or a part of one."""
        asked, path = _RANGE.fullmatch(self.headers.get("Range", "")), Path(self.translate_path(self.path))
        with suppress(BrokenPipeError, ConnectionResetError):  # whoever asked has seen enough
            if asked is None or not path.is_file():
                super().do_GET()
            else:
                self._part(path, int(asked[1]), int(asked[2]) if asked[2] else path.stat().st_size - 1)

    def _part(self, path: Path, first: int, last: int) -> None:
        size = path.stat().st_size
        last = min(last, size - 1)
        if first > last:
            self.send_error(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
            return
        self.send_response(HTTPStatus.PARTIAL_CONTENT)
        self.send_header("Content-Type", self.guess_type(path))
        self.send_header("Content-Range", f"bytes {first}-{last}/{size}")
        self.send_header("Content-Length", str(last + 1 - first))
        self.send_header("Last-Modified", self.date_time_string(path.stat().st_mtime))
        self.end_headers()
        with path.open("rb") as file:
            file.seek(first)
            self.wfile.write(file.read(last + 1 - first))

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the terminal is the user's."""
