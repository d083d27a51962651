"""The thirty checks pass where a server is right, and fail where it is wrong; the C header says the same as the code."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from structid.core.errors import InputError
from structid.hybrid.control.transfer_system import Actuator
from structid.hybrid.laboratory import server as server_module
from structid.hybrid.laboratory import wire
from structid.hybrid.laboratory.conformance import conformance
from structid.hybrid.laboratory.server import SpecimenServer
from structid.hybrid.laboratory.simulated_specimen import SimulatedSpecimen
from structid.hybrid.laboratory.specimen import SpecimenError
from structid.mechanics.restoring_forces import LinearForce

pytestmark = pytest.mark.quick
SECRET = "a secret of both sides"
DOCS = Path(__file__).parents[3] / "docs" / "reference"


def checked(**settings):
    structure = SimulatedSpecimen(LinearForce(np.eye(1)), Actuator(**settings))
    with SpecimenServer(structure, SECRET, watchdog=0.5) as server:
        return conformance(server.address, SECRET)


def failed(findings):
    return [f.what for f in findings if not f.passed]


def test_our_server_passes_all_thirty():
    found = checked(stroke=0.1)
    assert failed(found) == []
    assert len(found) == len({f.what for f in found}) == 30


def test_a_specimen_without_limits_does_not_pass():
    assert failed(checked()) == ["returns a reading at zero, and refuses a move beyond its limits"]


def broken(monkeypatch, what):
    if what == "tags":
        monkeypatch.setattr(wire.hmac, "compare_digest", lambda a, b: True)
    elif what == "nonces":
        monkeypatch.setattr(server_module.secrets, "token_bytes", lambda count: bytes(count))
    elif what == "holding":
        monkeypatch.setattr(SimulatedSpecimen, "hold", lambda self, reason: None)


@pytest.mark.parametrize(
    ("what", "some"),
    [
        (
            "tags",
            {"drops a forged request", "drops a HELLO with another secret", "drops a request with one bit changed"},
        ),
        ("nonces", {"generates a new nonce for every session", "drops a replayed session"}),
        ("holding", {"holds its position in every later session"}),
    ],
)
def test_a_server_that_is_careless_fails(monkeypatch, what, some):
    broken(monkeypatch, what)
    assert some <= set(failed(checked(stroke=0.1)))


def test_nobody_there():
    with pytest.raises(SpecimenError, match="No specimen answers"):
        conformance("127.0.0.1:1", SECRET)
    with pytest.raises(InputError, match="a host and a port"):
        conformance("there", SECRET)


# --- the page and the header ----------------------------------------------------------------------------------------


def test_the_header_compiles_and_says_what_the_code_says(tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler")
    program = tmp_path / "sizes.c"
    kinds = ", ".join(f"SPECIMEN_{kind.name}" for kind in wire.Kind)
    program.write_text(
        f"""#include <stdio.h>
#include <stddef.h>
#include "{DOCS / "specimen_protocol.h"}"
int main(void) {{
  int kinds[] = {{{kinds}}};
  printf("%zu %zu %zu %zu", sizeof(struct specimen_header), offsetof(struct specimen_header, sequence),
         offsetof(struct specimen_header, length), sizeof(struct specimen_move_head));
  printf(" %d %d %d %u", SPECIMEN_VERSION, SPECIMEN_TAG_BYTES, SPECIMEN_NONCE_BYTES, SPECIMEN_LARGEST_PAYLOAD);
  for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) printf(" %d", kinds[k]);
  printf("\\n%s\\n%s\\n%s\\n", SPECIMEN_MAGIC, SPECIMEN_GREETING_WORDS, SPECIMEN_SESSION_WORDS);
  return 0;
}}
"""
    )
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", program, "-o", tmp_path / "sizes"], check=True)
    said = subprocess.run([tmp_path / "sizes"], check=True, capture_output=True, text=True).stdout.splitlines()
    numbers = [24, 8, 16, 12, wire.VERSION, wire.TAG, wire.NONCE, wire.LARGEST_PAYLOAD, *map(int, wire.Kind)]
    assert [int(x) for x in said[0].split()] == numbers
    assert (wire.HEADER.size, wire.MOVE_HEAD.size) == (24, 12)
    assert said[1].encode() == wire.MAGIC
    assert wire.hmac.digest(b"s", said[2].encode(), "sha256") == wire.greeting_key(b"s")
    assert wire.hmac.digest(b"s", said[3].encode() + b"cd", "sha256") == wire.session_key(b"s", b"c", b"d")


def test_the_page_names_every_kind_and_every_part_of_a_description():
    page = (DOCS / "specimen_protocol.md").read_text()
    for kind in wire.Kind:
        assert re.search(rf"\b{kind.name}\b", page), kind
    described = SimulatedSpecimen(LinearForce(np.eye(1))).describe()
    for name in (*type(described).model_fields, *type(described.channels[0]).model_fields):
        assert f'"{name}"' in page or f"`{name}`" in page, name
