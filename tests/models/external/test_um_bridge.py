"""UM-Bridge: our client and the official server, the official client and our server."""

import http.server
import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import solvers
import structid as si
from servers import free_port, served, serving_waves
from structid.core.errors import InputError, Status
from structid.models.external.um_bridge import ServedModel, check_address, is_this_machine
from studies import PLAIN, shortened

RECORD = si.GroundMotion(np.sin(np.arange(400) * 0.05), 0.01, "sine")


def test_our_client_runs_a_server_written_with_the_official_package():
    pytest.importorskip("umbridge")
    url = serving_waves()
    model = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "wave", time_limit=20.0)
    theta = np.array([[1.5, 2.0], [9.0, 2.0], [0.5, 3.0]])
    found = model.simulate(theta, RECORD)
    np.testing.assert_allclose(found.values[0, :, 0], 1.5 * np.sin(2.0 * RECORD.time), rtol=1e-14)
    assert found.status.tolist() == [Status.DONE, Status.FAILED, Status.DONE]
    # The official server answers an exception of its model with a page: its status and words are all that it says.
    assert "answered Evaluate with HTTP status 500" in found.reasons[1] and "did not answer" not in found.reasons[1]
    wrong = si.UMBridgeModel(url, ("a",), ("velocity",), "wave").simulate(theta[:1, :1], RECORD)
    assert "takes 2 numbers, but it has 1 parameters here" in wrong.reasons[0]
    short = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "wave", {"samples": 300}).simulate(theta[:1], RECORD)
    assert "300 rows" in short.reasons[0]
    nobody = si.UMBridgeModel(url, ("a", "b"), ("velocity",), "ripple").simulate(theta[:1], RECORD)
    assert "has no model 'ripple'; it offers wave" in nobody.reasons[0]


OUTPUT = '{"output": [[0.0, 1.0, %s, 3.0]]}'
ANSWERS = {
    "NaN of Python": (200, OUTPUT % "NaN", Status.DIVERGED, "not finite from 0.02 s on"),
    "nan of C++": (200, OUTPUT % "-nan", Status.DIVERGED, "not finite from 0.02 s on"),
    "null of a careful server": (200, OUTPUT % "null", Status.DIVERGED, "not finite from 0.02 s on"),
    "infinity": (200, OUTPUT % "inf", Status.DIVERGED, "not finite from 0.02 s on"),
    "an error of the protocol": (
        400,
        '{"error": {"type": "InvalidInput", "message": "stiffness must be positive"}}',
        Status.FAILED,
        "answered with an error: InvalidInput: stiffness must be positive",
    ),
    "a page": (
        500,
        "<html><body><h1>500 Internal</h1> matrix is <b>singular</b></body></html>",
        Status.FAILED,
        "answered Evaluate with HTTP status 500: 500 Internal matrix is singular",
    ),
    "nothing": (503, "", Status.FAILED, "HTTP status 503: nothing"),
    "another thing": (200, '{"result": 1}', Status.FAILED, 'HTTP status 200: {"result": 1}'),
}


@pytest.mark.parametrize("case", ANSWERS)
def test_what_a_server_answers_is_in_the_reason(case):
    """A server of four samples; it says one thing to every evaluation."""
    pytest.importorskip("requests")
    status, text, expected, reason = ANSWERS[case]

    class Handler(http.server.BaseHTTPRequestHandler):
        def answered(self, status, text):
            self.send_response(status)
            self.end_headers()
            self.wfile.write(text.encode())

        def do_GET(self):
            self.answered(200, '{"protocolVersion": 1.0, "models": ["forward"]}')

        def do_POST(self):
            self.rfile.read(int(self.headers["Content-Length"]))
            self.answered(*((status, text) if self.path == "/Evaluate" else (200, '{"inputSizes": [1]}')))

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        model = si.UMBridgeModel(f"http://127.0.0.1:{server.server_port}", ("a",), ("velocity",))
        found = model.simulate([[1.0]], si.GroundMotion(np.zeros(4), 0.01))
        server.shutdown()
    assert found.status[0] == expected and reason in found.reasons[0], found.reasons[0]


LISTENING = Path("/proc/net/tcp")


@pytest.mark.slow
def test_the_official_client_reads_our_server(tmp_path, study_space):

    study = tmp_path / "study.toml"
    study.write_text(shortened(PLAIN, "9 s"))
    pytest.importorskip("umbridge")
    port = free_port()
    command = [
        sys.executable,
        "-c",
        "from structid.cli.main import main; main()",
        "serve",
        str(study),
        "--port",
        str(port),
    ]
    process, names = served(command, port)
    try:
        import umbridge

        from structid.study.run import load

        built = load(study)
        assert names == ["forward", "posterior"]
        if LISTENING.exists():
            # Columns: a number, the local address and port in hexadecimal, the remote ones, the state; 0A listens.
            rows = [line.split() for line in LISTENING.read_text().splitlines()[1:]]
            heard = {row[1].split(":")[0] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port}
            assert heard == {"0100007F"}, "this machine's own address alone"
        forward = umbridge.HTTPModel(f"http://127.0.0.1:{port}", "forward")
        assert forward.get_input_sizes() == [4] and forward.get_output_sizes() == [601]
        theta = built.space.sample(1, seed=2).values
        (answer,) = forward(theta.tolist())
        expected = built.model.simulate(theta, built.record).values[0, :, 0]
        np.testing.assert_allclose(answer, expected, rtol=1e-12, atol=1e-15)
        short = {"record": {"dt": 0.01, "values": built.record.values[:200].tolist()}}
        np.testing.assert_allclose(forward(theta.tolist(), short)[0], expected[:200], rtol=1e-9, atol=1e-12)
        # Derivatives through the protocol against differences through the protocol.
        direction = [theta[0, 0] * 1e-6, 0.0, 0.0, 0.0]
        step = np.array([direction])
        difference = (np.array(forward((theta + step).tolist())[0]) - np.array(forward((theta - step).tolist())[0])) / 2
        jacobian = np.array(forward.apply_jacobian(0, 0, theta.tolist(), direction))
        # A difference across a kink of the law (the velocity changes sign within a step) is of first order only.
        np.testing.assert_allclose(jacobian, difference, atol=1e-3 * np.abs(jacobian).max())
        weights = np.linspace(-1.0, 1.0, 601).tolist()
        gradient = forward.gradient(0, 0, theta.tolist(), weights)
        assert np.dot(gradient, direction) == pytest.approx(np.dot(weights, jacobian), rel=1e-8)
        density = umbridge.HTTPModel(f"http://127.0.0.1:{port}", "posterior")
        phi = built.posterior.space.sample(1, seed=3).values
        assert density(phi.tolist())[0][0] == pytest.approx(built.posterior.log_density(phi)[0], rel=1e-10)
        phi[0, 0] = -1.0
        assert density(phi.tolist())[0][0] < -1e300
    finally:
        process.kill()
        process.wait()


def test_a_run_that_fails_is_too_short_for_the_protocol():
    model = si.CallableModel(solvers.misbehaving, ("a",), ("velocity",), isolated=False)
    served_model = ServedModel(model, RECORD)
    assert [len(v) for v in served_model([[2.0]], {})] == [100]
    assert served_model.get_output_sizes({}) == [400]
    assert not served_model.supports_gradient()


@pytest.mark.parametrize(("host", "port"), [("no such host", 4242), ("127.0.0.1", 99_999), ("203.0.113.7", 4242)])
def test_an_address_at_which_nobody_can_listen(host, port):
    with pytest.raises(InputError, match=f"this machine cannot listen at the address {host}:{port}"):
        check_address(host, port)


def test_who_else_can_reach_an_address():
    assert is_this_machine("127.0.0.1") and is_this_machine("localhost") and not is_this_machine("0.0.0.0")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="in use"):
            check_address("127.0.0.1", taken.getsockname()[1])
