"""Messages to a slow viewer are merged, and no update is lost."""

import json

import pytest
from page_host import told

from aras_visual_servo_bench.web.live.outbox import MAX_UNACKNOWLEDGED, Outbox, merge_updates
from aras_visual_servo_bench.web.live.page_state import PageState
from aras_visual_servo_bench.web.live.plot_samples import MAX_SAMPLES


def news(stamp, **more):
    return {"kind": "update", "stamp": stamp, **more}


@pytest.fixture
def sent():
    return []


@pytest.fixture
def outbox(sent):
    return Outbox(lambda m: sent.append(m if isinstance(m, bytes) else json.loads(m)))


def test_who_keeps_up_is_told_everything_at_once(outbox, sent):
    for i in range(20):
        outbox.send_update(news(i))
        outbox.send_image(bytes([i]))
        assert sent == [news(i), bytes([i])]
        sent.clear()
        outbox.acknowledge()
        outbox.acknowledge()
    texts = []
    Outbox(texts.append).send_update(news(1.0), "as it is")  # is not made again
    assert texts == ["as it is"]


def test_who_is_slow_gets_the_last_of_everything_in_one(outbox, sent):
    for i in range(MAX_UNACKNOWLEDGED):
        outbox.send_update(news(i))
    outbox.send_update(news(10, told={"phase": "holding"}, samples=[[1.0]], names=["xn"]))
    outbox.send_update(news(11, shapes={"path": 1, "goal": 1}))
    outbox.send_update(news(12, shapes={"path": None}, samples=[[2.0]], names=["xn"]))
    outbox.send_image(b"first")
    outbox.send_image(b"last")
    assert sent == [news(i) for i in range(MAX_UNACKNOWLEDGED)]
    sent.clear()
    outbox.acknowledge()
    assert sent == [news(12, told={"phase": "holding"}, samples=[[1.0], [2.0]], names=["xn"],
                         shapes={"path": None, "goal": 1})]  # fmt: skip
    outbox.acknowledge()
    assert sent[1:] == [b"last"]
    outbox.acknowledge()
    assert len(sent) == 2
    outbox.send_update(news(13))
    assert sent[2:] == [news(13)]


def test_seen_more_often_than_sent_allows_no_more(outbox, sent):
    for _ in range(10):
        outbox.acknowledge()
    for i in range(10):
        outbox.send_update(news(i))
    assert len(sent) == MAX_UNACKNOWLEDGED


def test_plots_that_begin_anew_forget_what_was_before():
    both = merge_updates(news(1, samples=[[5.0], [6.0]]), news(2, samples=[["clear"], [0.1]]))
    assert both["samples"] == [["clear"], [0.1]]
    assert merge_updates(both, news(3, samples=[[0.2]]))["samples"] == [["clear"], [0.1], [0.2]]
    whole = {"kind": "full", "stamp": 1.0, "samples": [], "shapes": {"path": 1}}
    assert merge_updates(whole, news(2.0, samples=[[1.0]])) == {
        "kind": "full", "stamp": 2.0, "samples": [[1.0]], "shapes": {"path": 1}}


def test_who_never_looks_misses_nothing_of_the_run_and_fills_no_memory(outbox, sent):
    page = PageState()
    for i in range(3 * MAX_SAMPLES):
        page.add_sample(told(i / 30, error=(0.99**i, 0.0)), [])
        if i % 7 == 0:
            outbox.send_update(page.make_update(None, (), (), i / 30))
    outbox.send_update(page.make_update(None, (), (), i / 30))
    outbox.acknowledge()
    rows = sent[-1]["samples"]
    assert rows[0] == ["clear"] and rows[1:] == page.make_full_message()["samples"]
    assert len(rows) <= MAX_SAMPLES + 1
