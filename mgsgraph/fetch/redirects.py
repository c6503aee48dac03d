"""Where redirects may lead: to http and https, not from https to http, nor from the world into a private network."""

import ipaddress
import socket
from urllib.parse import urljoin, urlsplit

from mgsgraph.errors import InputError
from mgsgraph.fetch.archives import require_address

REDIRECTS = 10
"""Followed at the most."""
_ELSEWHERE = "try later, or another mirror"


def led_to(url: str, address: str, location: str) -> str:
    """The address that a redirect of another one leads to; `url` is what was asked for.

    Raises
    ------
    InputError
        None of http or https; from https to http; from the world into this machine or its private network.
    """
    try:
        to = urljoin(address, location)
        parts, before = urlsplit(to), urlsplit(address)
    except ValueError:
        raise InputError(url, f"redirected to {location!r}", "an address", _ELSEWHERE) from None
    require_address(to.partition("?")[0].partition("#")[0], f"{url}, redirected")
    if before.scheme == "https" and parts.scheme != "https":
        raise InputError(url, f"redirected to {to}, which is not encrypted", "https", _ELSEWHERE)
    if parts.hostname != before.hostname and _is_inner(parts.hostname) and not _is_inner(before.hostname):
        raise InputError(url, f"redirected into a private network, to {parts.hostname}", "a public host", _ELSEWHERE)
    return to


def _is_inner(host: str | None) -> bool:
    """Whether any of a host's addresses is one of this machine or of a private network, as far as it is known."""
    try:
        found = socket.getaddrinfo(host, None)
    except (OSError, ValueError):  # unknown, or known to a proxy alone
        return False
    return any(not ipaddress.ip_address(str(one[4][0]).partition("%")[0]).is_global for one in found)
