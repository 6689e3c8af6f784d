"""Threads may decode their first records at one time: how, msgspec worked out when the modules were imported (ADR 0057)."""

import subprocess
import sys

_RACE = """
import sys, threading
import msgspec
from firmware_protocol.contract import announcements, commands, mission_orders, recordings, records
from firmware_protocol.errors import RecordError

def kinds_below(kind):
    return [one for child in kind.__subclasses__() for one in kinds_below(child)] or [kind]

sys.setswitchinterval(1e-6)
kinds = kinds_below(records.Struct)
octets = {kind: msgspec.msgpack.encode(dict.fromkeys(kind.__struct_encode_fields__)) for kind in kinds}
together = threading.Barrier(8)

def decode_all():
    for kind in kinds:
        together.wait()
        try:
            records.decode_record(octets[kind], kind)
        except RecordError:
            pass

threads = [threading.Thread(target=decode_all) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(kinds))
"""

_LAW = """
import ast, importlib, inspect, pkgutil, sys
import msgspec

DECODERS = {"decode", "convert", "decode_record"}

def import_all():
    for package in ("firmware_protocol", "gateway", "mapper", "simulator"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
            if not module.name.endswith(("__main__", "._bulk", "._kernels", "._engine")):  # the last three are C without Python
                yield importlib.import_module(module.name)

def kinds_in(module):
    source = inspect.getsource(module)
    for call in ast.walk(ast.parse(source if any(f"{name}(" in source for name in DECODERS) else "")):
        if isinstance(call, ast.Call) and ast.unparse(call.func).rpartition(".")[2] in DECODERS:
            given = [word.value for word in call.keywords if word.arg == "type"] or call.args[1:2]
            for name in (one for kind in given for one in ast.walk(kind) if isinstance(one, ast.Name)):
                kind = getattr(module, name.id, None)
                if isinstance(kind, type) and (issubclass(kind, msgspec.Struct) or hasattr(kind, "__dataclass_fields__")):
                    yield kind

def is_prepared(kind):
    calls = []
    sys.setprofile(lambda frame, event, _: calls.append(frame.f_code.co_name) if event == "call" else None)
    try:
        msgspec.msgpack.Decoder(kind)
    finally:
        sys.setprofile(None)
    return "get_class_annotations" not in calls

class Unprepared(msgspec.Struct):
    number: int

modules = list(import_all())
kinds = dict.fromkeys(kind for module in modules for kind in kinds_in(module))
assert not is_prepared(Unprepared) and is_prepared(Unprepared)  # it is seen
print(len(kinds), *(f"{kind.__module__}.{kind.__name__}" for kind in kinds if not is_prepared(kind)))
"""


def test_threads_decode_their_first_records_at_one_time() -> None:
    """Nothing but the process's end shows it: a thread that comes while a type is worked out follows a null pointer."""
    for _ in range(4):  # of four processes without preparation, one in a hundred times none meets it
        ran = subprocess.run([sys.executable, "-c", _RACE], capture_output=True, text=True, check=False, timeout=120)
        assert ran.returncode == 0, f"{ran.returncode}: {ran.stderr}"
        assert int(ran.stdout) > 15


def test_whatever_is_decoded_is_prepared_where_its_module_is_imported() -> None:
    ran = subprocess.run([sys.executable, "-c", _LAW], capture_output=True, text=True, check=False, timeout=120)
    assert ran.returncode == 0, ran.stderr
    n_kinds, *unprepared = ran.stdout.split()
    assert not unprepared, f"{unprepared} lack a prepare() (firmware_protocol/first_use.py) or a Decoder in their module"
    assert int(n_kinds) > 25
