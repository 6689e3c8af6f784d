"""What has to be done once, before threads come: msgspec works out at a type's first use how its values are decoded."""

import msgspec


def prepare(*kinds: object) -> None:
    """Have msgspec work out how values of these types are decoded, and of all types in them; to be called where a module is imported.

    While it does so, another thread that decodes a value of such a type follows a null pointer, and the process is gone: the type already
    refers to what is not filled in yet, and working it out runs Python code, which lets other threads in (msgspec 0.22.0, ADR 0057). A
    module is imported by one thread, and nobody has its types before. A ``Decoder`` that is made in a module does the same for its type.
    """
    for kind in kinds:
        msgspec.msgpack.Decoder(kind)  # its types serve JSON and `msgspec.convert` too
