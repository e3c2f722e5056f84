"""Who may see the live page."""

import pytest

from aras_visual_servo_bench.live.access import Access

TOKEN = "abcDEF-123_xyz"
HOME = Access("127.0.0.1", 8090, TOKEN)
OPEN = Access("0.0.0.0", 8090, TOKEN)


@pytest.mark.parametrize("host", ["127.0.0.1:8090", "localhost:8090", "LocalHost:8090"])
def test_this_machine_s_names_are_served(host):
    assert HOME.refusal(TOKEN, host, None) == ""
    assert HOME.refusal(TOKEN, host, f"http://{host}") == ""


@pytest.mark.parametrize("host", [
    "", ":8090", "127.0.0.1", "127.0.0.1:80", "127.0.0.1:8091", "127.0.0.1:18090",
    "evil.example:8090", "127.0.0.1:8090/", "127.0.0.1:8090?x", "me@127.0.0.1:8090",
    "127.0.0.1:x", "127.0.0.1:99999999",
    "127.0.0.1:" + "8" * 5000, "127.0.0.1.evil.example:8090", "10.0.0.5:8090", "[::1:8090",
])  # fmt: skip
def test_other_names_are_refused(host):
    assert "not served under the name" in HOME.refusal(TOKEN, host, None)


@pytest.mark.parametrize("origin", [
    "", "null", "http://", "https://127.0.0.1:8090", "http://127.0.0.1:8091", "http://127.0.0.1",
    "http://evil.example:8090", "http://127.0.0.1:8090/page", "http://x@127.0.0.1:8090",
    "ftp://127.0.0.1:8090", "127.0.0.1:8090",
])  # fmt: skip
def test_pages_of_other_origins_may_not_ask(origin):
    assert "may not ask here" in HOME.refusal(TOKEN, "127.0.0.1:8090", origin)


@pytest.mark.parametrize("token", ["", *(TOKEN[:k] for k in range(1, len(TOKEN))), TOKEN + "x",
                                   TOKEN.lower(), "ä"])  # fmt: skip
def test_the_whole_token_is_needed(token):
    said = HOME.refusal(token, "127.0.0.1:8090", None)
    assert ("no token" if not token else "not this simulator's") in said


@pytest.mark.parametrize("host", ["192.168.7.20:8090", "[fe80::1]:8090", "[::1]:8090"])
def test_an_open_page_is_served_under_addresses(host):
    assert OPEN.refusal(TOKEN, host, f"http://{host}") == ""


@pytest.mark.parametrize("host", ["cafe.de:8090", "dead.beef:8090", "abc:8090", "1.2.3:8090",
                                  "256.1.1.1:8090", "evil.example:8090", "192.168.7.20:80"])
def test_and_under_no_name_that_a_foreign_page_could_have(host):
    assert OPEN.refusal(TOKEN, host, None) and OPEN.refusal(TOKEN, "localhost:8090", f"http://{host}")


def test_without_a_port_it_is_80():
    web = Access("machine.lab", 80, TOKEN)
    assert web.refusal(TOKEN, "machine.lab", "http://machine.lab") == ""
    assert web.refusal(TOKEN, "machine.lab:80", "http://machine.lab:80") == ""


@pytest.mark.parametrize(("host", "address"), [
    ("127.0.0.1", "http://127.0.0.1:80/"), ("0.0.0.0", "http://127.0.0.1:80/"),
    ("::", "http://127.0.0.1:80/"), ("::1", "http://[::1]:80/"), ("lab", "http://lab:80/"),
])  # fmt: skip
def test_the_address_to_open(host, address):
    assert Access(host, 80, "t").address == f"{address}?token=t"
