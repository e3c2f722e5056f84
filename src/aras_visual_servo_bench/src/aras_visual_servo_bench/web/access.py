"""Access rules of the web servers: a token in the address, and no requests of other origins."""

from __future__ import annotations

import hmac
import re
import secrets
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv6Address, ip_address

LOCAL_HOSTS = (IPv4Address("127.0.0.1"), "localhost")
# Host header: a name or an IPv6 address in brackets, and optionally a port.
HOST_PATTERN = re.compile(
    r"(?:\[(?P<six>[^][]+)\]|(?P<name>[^][:@/?#\\\s]+))(?::(?P<port>[0-9]{1,5}))?"
)


@dataclass(frozen=True)
class Access:
    """Access rules of one server.

    Attributes:
        host, port: address on which the server listens.
        token: secret that the address of a request must contain.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token: str = field(default_factory=lambda: secrets.token_urlsafe(18))

    @property
    def address(self) -> str:
        """URL to open in a browser."""
        host = self.host
        if self._is_wildcard:
            host = "::1" if ":" in host else "127.0.0.1"
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    def refusal_reason(self, token: str, host: str, origin: str | None) -> str:
        """Return why a request is refused; '' if it is allowed.

        Args:
            token: token of the request's address.
            host: Host header. Its check prevents DNS rebinding: a foreign page whose domain name
                resolves to this machine sends that name.
            origin: Origin header, or None.
        """
        if not self._is_own(host):
            return f"this page is not served under the name {host[:60]!r}"
        if origin is not None and not (
            origin.startswith("http://") and self._is_own(origin.removeprefix("http://"))
        ):
            return f"requests from pages of {origin[:60]!r} are not allowed"
        if not token:
            return "the address has no token: open the one that the simulator printed"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is not this simulator's: open the address that it printed"
        return ""

    @property
    def _is_wildcard(self) -> bool:
        """Whether the server listens on all addresses of the machine."""
        host = _normalize_host(self.host)
        return host == "" or not isinstance(host, str) and host.is_unspecified

    def _is_own(self, host: str) -> bool:
        """Return whether a Host header, NAME:PORT, refers to this server."""
        found = HOST_PATTERN.fullmatch(host)
        if found is None or int(found["port"] or 80) != self.port:
            return False
        name = _normalize_host(found["six"] or found["name"])
        if isinstance(name, IPv6Address) != bool(found["six"]):
            return False
        # On all addresses, the names by which other machines know this one are unknown. An IP
        # address is accepted then, because DNS rebinding needs a name.
        if self._is_wildcard:
            is_own = not isinstance(name, str)
        else:
            is_own = name == _normalize_host(self.host)
        return is_own or name in LOCAL_HOSTS


def _normalize_host(text: str) -> str | IPv4Address | IPv6Address:
    """Return an IP address without its zone, or any other name in lower case."""
    try:
        found = ip_address(text)
    except ValueError:
        return text.lower()
    return IPv6Address(found.packed) if found.version == 6 else found
