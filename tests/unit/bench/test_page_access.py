"""Access rules of the live page."""

import ipaddress
import random

import pytest

from aras_visual_servo_bench.web.access import Access

TOKEN = "abcDEF-123_xyz"
HOME = Access("127.0.0.1", 8090, TOKEN)
OPEN = Access("0.0.0.0", 8090, TOKEN)


@pytest.mark.parametrize(("access", "hosts"), [
    (HOME, ["127.0.0.1:8090", "localhost:8090", "LocalHost:8090"]),
    (OPEN, ["192.168.7.20:8090", "[fe80::1]:8090", "[::1]:8090", "[fe80::1%eth0]:8090",
            "localhost:8090"])])  # fmt: skip
def test_this_machine_s_names_are_served(access, hosts):
    for host in hosts:
        assert access.refusal_reason(TOKEN, host, None) == ""
        assert access.refusal_reason(TOKEN, host, f"http://{host}") == ""


@pytest.mark.parametrize("listening", ["", "0.0.0.0", "::"])
def test_a_page_for_all_is_served_under_no_name_that_a_foreign_page_could_have(listening):
    access = Access(listening, 8090, TOKEN)
    assert access.refusal_reason(TOKEN, "192.168.7.20:8090", None) == ""
    for host in (
        "evil.example:8090", "192.168.7.20:80", "192.168.7.20", "[fe80::1]:80", "fe80::1:8090",
        "[192.168.7.20]:8090", "evil[fe80::1]:8090", "[fe80::1]evil:8090", "[fe80::1%]:8090",
        "192.168.7.20%eth0:8090", "0xc0.0xa8.1.1:8090", ":8090",
    ):  # fmt: skip
        assert "not available under" in access.refusal_reason(TOKEN, host, None), host
        assert "are not allowed" in access.refusal_reason(
            TOKEN, "localhost:8090", f"http://{host}"), host


@pytest.mark.parametrize("host", [
    "", ":8090", "127.0.0.1", "127.0.0.1:80", "127.0.0.1:8091", "127.0.0.1:18090",
    "evil.example:8090", "127.0.0.1:8090/", "127.0.0.1:8090?x", "me@127.0.0.1:8090",
    "127.0.0.1:x", "127.0.0.1:99999999", "127.0.0.1:8090\n", "127.0.0.1\t:8090", "127.0.0.1:٨٠٩٠",
    "127.0.0.1:" + "8" * 5000, "127.0.0.1.evil.example:8090", "10.0.0.5:8090", "[::1:8090",
    "[127.0.0.1]:8090", "[localhost]:8090", "evil[localhost]:8090", "[localhost]evil:8090"])
def test_other_names_are_refused(host):
    assert "not available under the name" in HOME.refusal_reason(TOKEN, host, None)


@pytest.mark.parametrize("origin", [
    "", "null", "http://", "https://127.0.0.1:8090", "http://127.0.0.1:8091", "http://127.0.0.1",
    "http://evil.example:8090", "http://127.0.0.1:8090/page", "http://x@127.0.0.1:8090",
    "ftp://127.0.0.1:8090", "127.0.0.1:8090", "http://[::1", "http://http://127.0.0.1:8090"])
def test_pages_of_other_origins_may_not_ask(origin):
    assert "are not allowed" in HOME.refusal_reason(TOKEN, "127.0.0.1:8090", origin)


@pytest.mark.parametrize("token", ["", *(TOKEN[:k] for k in range(1, len(TOKEN))), TOKEN + "x",
                                   TOKEN.lower(), "ä"])  # fmt: skip
def test_the_whole_token_is_needed(token):
    said = HOME.refusal_reason(token, "127.0.0.1:8090", None)
    assert ("no token" if not token else "the token is wrong") in said
    assert TOKEN not in said


def test_of_any_names_an_open_page_takes_addresses_alone():
    """Names of the letters that addresses are made of, against their definition."""
    chosen = random.Random(29)
    for _ in range(3000):
        name = "".join(chosen.choices("0123456789abcdef.:", k=chosen.randint(1, 12)))
        if ":" in name:
            host, version = f"[{name}]:8090", 6
        else:
            host, version = f"{name}:8090", 4
        try:
            wanted = ipaddress.ip_address(name).version == version
        except ValueError:
            wanted = False
        assert (OPEN.refusal_reason(TOKEN, host, f"http://{host}") == "") == wanted, host
    for _ in range(200):
        four, six = (ipaddress.IPv4Address(chosen.getrandbits(32)),
                     ipaddress.IPv6Address(chosen.getrandbits(128)))  # fmt: skip
        assert OPEN.refusal_reason(TOKEN, f"{four}:8090", None) == ""
        origin = f"http://[{six.exploded.upper()}]:8090"
        assert OPEN.refusal_reason(TOKEN, f"[{six}]:8090", origin) == ""
        assert OPEN.refusal_reason(TOKEN, f"[{six}]:8091", None)


@pytest.mark.parametrize(("host", "named"), [
    ("Lab-PC", "lab-pc"), ("2001:DB8:0:0::7", "[2001:db8::7]"), ("fe80::1%eth0", "[fe80::1]"),
    ("::1", "[::1]"), ("10.0.0.5", "10.0.0.5")])  # fmt: skip
def test_the_address_that_is_printed_is_served_as_browsers_write_it(host, named):
    access = Access(host, 8090, TOKEN)
    assert access.refusal_reason(TOKEN, f"{named}:8090", f"http://{named}:8090") == ""
    assert access.refusal_reason(TOKEN, "10.0.0.6:8090", None)
    assert access.refusal_reason(TOKEN, "[2001:db8::8]:8090", None)


def test_without_a_port_it_is_80():
    web = Access("machine.lab", 80, TOKEN)
    assert web.refusal_reason(TOKEN, "machine.lab", "http://machine.lab") == ""
    assert web.refusal_reason(TOKEN, "machine.lab:80", "http://machine.lab:80") == ""
    assert web.refusal_reason(TOKEN, "machine.lab:0", None)


@pytest.mark.parametrize(("host", "address"), [
    ("127.0.0.1", "http://127.0.0.1:80/"), ("0.0.0.0", "http://127.0.0.1:80/"),
    ("::", "http://[::1]:80/"), ("", "http://127.0.0.1:80/"), ("::1", "http://[::1]:80/"),
    ("lab", "http://lab:80/")])  # fmt: skip
def test_the_address_to_open(host, address):
    assert Access(host, 80, "t").address == f"{address}?token=t"


def test_tokens_are_not_to_be_guessed():
    tokens = {Access().token for _ in range(50)}
    assert len(tokens) == 50 and min(map(len, tokens)) >= 20
