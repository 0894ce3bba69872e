import os
import signal
import threading

import pytest

from protocol.interrupt import interrupts


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_is_a_wish_and_the_second_insists(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with interrupts() as interrupt:
        woken: list[bool] = []
        interrupt.on_request.append(lambda: woken.append(True))
        os.kill(os.getpid(), number)
        assert interrupt.requested
        assert woken == [True]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before


def test_outside_the_main_thread_only_a_request_counts() -> None:
    seen: list[bool] = []

    def body() -> None:
        with interrupts() as interrupt:
            interrupt.request()
            seen.append(interrupt.requested)

    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert seen == [True]
