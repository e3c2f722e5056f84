"""Access rules of the web servers: requests need a token and must come from the server's own page.
"""

from __future__ import annotations

import hmac
import re
import secrets
from dataclasses import dataclass, field
from ipaddress import IPv4Address, IPv6Address, ip_address

LOCAL_HOSTS = (IPv4Address("127.0.0.1"), "localhost")
# Form of a Host header: a name or an IPv6 address in brackets, with an optional port.
HOST_PATTERN = re.compile(
    r"(?:\[(?P<six>[^][]+)\]|(?P<name>[^][:@/?#\\\s]+))(?::(?P<port>[0-9]{1,5}))?"
)


@dataclass(frozen=True)
class Access:
    """Access rules of one server.

    Attributes:
        host, port: address and port on which the server listens.
        token: secret that the URL of a request must contain.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    token: str = field(default_factory=lambda: secrets.token_urlsafe(18))

    @property
    def address(self) -> str:
        """URL that the user opens in a browser."""
        host = self.host
        if self._is_wildcard:
            host = "::1" if ":" in host else "127.0.0.1"
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    def refusal_reason(self, token: str, host: str, origin: str | None) -> str:
        """Return why a request is refused; '' if it is allowed.

        Args:
            token: token in the URL of the request; '' if there is none.
            host: Host header of the request. It must be an address or name of this server. This
                prevents DNS rebinding, an attack by a foreign page whose domain name resolves to
                this machine.
            origin: Origin header of the request; None if there is none.
        """
        if not self._is_own(host):
            return (
                f"this page is not available under the name {host[:60]!r}: open the address that "
                "the simulator has printed"
            )
        if origin is not None and not (
            origin.startswith("http://") and self._is_own(origin.removeprefix("http://"))
        ):
            return (
                f"requests from pages of {origin[:60]!r} are not allowed: open the address that "
                "the simulator has printed"
            )
        if not token:
            return "the address has no token: open the address that the simulator has printed"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "the token is wrong: open the address that the simulator has printed"
        return ""

    @property
    def _is_wildcard(self) -> bool:
        """True if the server listens on all addresses of the machine."""
        host = _normalize_host(self.host)
        return host == "" or not isinstance(host, str) and host.is_unspecified

    def _is_own(self, host: str) -> bool:
        """Return whether a Host header (NAME or NAME:PORT) is that of this server."""
        found = HOST_PATTERN.fullmatch(host)
        if found is None or int(found["port"] or 80) != self.port:
            return False
        name = _normalize_host(found["six"] or found["name"])
        if isinstance(name, IPv6Address) != bool(found["six"]):
            return False
        # A server that listens on all addresses does not know all its names. It accepts any IP
        # address in the Host header, because DNS rebinding needs a domain name.
        if self._is_wildcard:
            is_own = not isinstance(name, str)
        else:
            is_own = name == _normalize_host(self.host)
        return is_own or name in LOCAL_HOSTS


def _normalize_host(text: str) -> str | IPv4Address | IPv6Address:
    """Return the IP address (IPv6 without zone) in a text, or a name in lower case."""
    try:
        found = ip_address(text)
    except ValueError:
        return text.lower()
    return IPv6Address(found.packed) if found.version == 6 else found
