"""Who may see the page: a token in the address, and no page of another origin."""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import urlsplit

LOCAL = ("127.0.0.1", "localhost")
ANYWHERE = ("0.0.0.0", "::", "")  # addresses to listen on that are no name of a machine


@dataclass(frozen=True)
class Access:
    """The rules of one server.

    Attributes:
        host, port: that it listens on.
        token: that an address has to carry.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token: str = field(default_factory=lambda: secrets.token_urlsafe(18))

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = "127.0.0.1" if self.host in ANYWHERE else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    def refusal(self, token: str, host: str, origin: str | None) -> str:
        """Why a request is not answered, '' where it is.

        Args:
            token: of its address.
            host: its Host header. A page of elsewhere that has its name point to this machine
                would carry that name.
            origin: its Origin header, None where it has none.
        """
        if not self._ours(f"http://{host}"):
            return f"this page is not served under the name {host[:60]!r}"
        if origin is not None and not self._ours(origin):
            return f"a page of {origin[:60]!r} may not ask here"
        if not token:
            return "the address has no token: open the one that the simulator printed"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is not this simulator's: open the address that it printed"
        return ""

    def _ours(self, origin: str) -> bool:
        """Whether http://NAME:PORT is one of this server's own."""
        try:
            parts = urlsplit(origin)
            name, port = parts.hostname or "", parts.port or 80
        except ValueError:
            return False
        if origin != f"http://{parts.netloc}" or "@" in parts.netloc or port != self.port:
            return False
        # Who opened the page to other machines cannot say by what names they know this one; there
        # an address is taken, which no foreign page can pretend to be.
        return name in LOCAL or name == self.host or self.host in ANYWHERE and _is_address(name)


def _is_address(name: str) -> bool:
    """Whether it is an IPv4 or IPv6 address, as a browser writes it."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
