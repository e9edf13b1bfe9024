"""Everything around the mathematics of `ssmr`: the MuJoCo robot, recordings, profiles, programs and pictures."""

import sys

import lazy_loader as lazy

if sys.argv[:1] == ["-m"] or sys.argv[0].endswith("/ssmr"):  # while a program is loaded, Ctrl-C ends it without a traceback
    import signal

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
