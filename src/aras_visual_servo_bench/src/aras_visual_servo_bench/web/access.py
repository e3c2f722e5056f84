"""Who may see the page: a token in the address, and no page of another origin."""

from __future__ import annotations

import hmac
import re
import secrets
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv6Address, ip_address

LOCAL_HOSTS = (IPv4Address("127.0.0.1"), "localhost")
# A Host header: a name, or an IPv6 address in brackets, and a port.
HOST_PATTERN = re.compile(
    r"(?:\[(?P<six>[^][]+)\]|(?P<name>[^][:@/?#\\\s]+))(?::(?P<port>[0-9]{1,5}))?"
)


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
        host = self.host
        if self._is_wildcard:
            host = "::1" if ":" in host else "127.0.0.1"
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    def refusal_reason(self, token: str, host: str, origin: str | None) -> str:
        """Why a request is not answered, '' where it is.

        Args:
            token: of its address.
            host: its Host header. A page of elsewhere that has its name point to this machine
                would carry that name.
            origin: its Origin header, None where it has none.
        """
        if not self._is_own(host):
            return f"this page is not served under the name {host[:60]!r}"
        if origin is not None and not (
            origin.startswith("http://") and self._is_own(origin.removeprefix("http://"))
        ):
            return f"a page of {origin[:60]!r} may not ask here"
        if not token:
            return "the address has no token: open the one that the simulator printed"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is not this simulator's: open the address that it printed"
        return ""

    @property
    def _is_wildcard(self) -> bool:
        """Whether it listens on all of the machine's addresses, and so has no name of its own."""
        own = _normalize_host(self.host)
        return own == "" or not isinstance(own, str) and own.is_unspecified

    def _is_own(self, host: str) -> bool:
        """Whether NAME:PORT, as in a Host header, is this server's."""
        found = HOST_PATTERN.fullmatch(host)
        if found is None or int(found["port"] or 80) != self.port:
            return False
        name = _normalize_host(found["six"] or found["name"])
        if isinstance(name, IPv6Address) != bool(found["six"]):
            return False
        # Who opened the page to other machines cannot say by what names they know this one; there
        # an address is taken, which no foreign page can pretend to be.
        own = not isinstance(name, str) if self._is_wildcard else name == _normalize_host(self.host)
        return own or name in LOCAL_HOSTS


def _normalize_host(text: str) -> str | IPv4Address | IPv6Address:
    """An address, however it is written and without its zone; any other name in lower case."""
    try:
        found = ip_address(text)
    except ValueError:
        return text.lower()
    return IPv6Address(found.packed) if found.version == 6 else found
