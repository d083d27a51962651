"""UM-Bridge: models on an HTTP server as structid models, and structid models on a server for UM-Bridge clients.

In the protocol (Seelinger et al. 2023, doi 10.21105/joss.04748), models are maps from lists of vectors to lists of vectors.
Here the first input vector contains the parameters in SI, and each channel has one output vector with its history in SI.
"""

from __future__ import annotations

import functools
import ipaddress
import json
import re
import socket
from collections.abc import Mapping, Sequence
from typing import Any
from unittest.mock import patch

import numpy as np

from structid.core.errors import InputError
from structid.core.hashing import digest
from structid.core.validation import check_arguments
from structid.ground_motion.excitation import Excitation
from structid.models.base import Model
from structid.models.external.external import ExternalModel
from structid.models.external.protocol import SolverError, Task
from structid.models.traceable import as_traceable

NOT_A_NUMBER = re.compile(r"(?<=[\[,:])\s*[-+]?(?:nan|inf|infinity|null|1\.#\w+)(?=\s*[,\]}])", re.IGNORECASE)
"""Pattern of the ways in which servers write NaN and infinity, which JSON does not define."""
FIRST_WORDS = 160
"""Number of characters shown from an invalid reply."""


@check_arguments
class UMBridgeModel(ExternalModel):
    """A model that a UM-Bridge server offers.

    Parameters
    ----------
    url : str
        Address of the server, ``"http://localhost:4242"``.
    free : sequence of str
        Names of the parameters, in the order of the server's input vectors.
    channels : sequence of str
        Names of the server's output vectors.
    name : str
        Name of the model on the server.
    config : mapping, optional
        Settings sent to the server with every run.
    send_record : bool
        Send the record in the configuration as ``{"record": {"name", "dt", "values"}}``, for a server that accepts any record.
    time_limit : float, optional
        Time limit of a run [s].
    version : str
        See `ExternalModel`. Change it whenever the computation on the server changes.
    units : mapping of str to str, optional
        See `ExternalModel`.

    Examples
    --------
    >>> import structid as si
    >>> model = si.UMBridgeModel("http://localhost:4242", free=("stiffness",), channels=("drift",))  # doctest: +SKIP
    """

    def __init__(
        self,
        url: str,
        free: Sequence[str],
        channels: Sequence[str],
        name: str = "forward",
        config: Mapping[str, Any] | None = None,
        send_record: bool = False,
        time_limit: float | None = None,
        version: str = "",
        units: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(free, channels, time_limit, version=version, units=units)
        self.url, self.name, self.config, self.send_record = url.rstrip("/"), name, dict(config or {}), send_record

    def solve(self, task: Task, excitation: Excitation) -> dict[str, list[float]]:
        """Request a run from the server; see `ExternalModel.solve`."""
        config = dict(self.config)
        if self.send_record:
            config["record"] = {"name": excitation.name, "dt": excitation.dt, "values": excitation.values.tolist()}
        _check_name(self.url, self.name)
        request = {"name": self.name, "config": config}
        sizes = _answer(self.url, "InputSizes", request, "inputSizes")
        if sum(sizes) != len(self.free):
            raise SolverError(
                f"the server's model takes {sum(sizes)} numbers, but it has {len(self.free)} parameters here"
            )
        values = iter(task.parameters.values())
        inputs = [[next(values) for _ in range(size)] for size in sizes]
        outputs = _answer(self.url, "Evaluate", {**request, "input": inputs}, "output")
        if len(outputs) != len(self.channels):
            raise SolverError(f"the server returned {len(outputs)} vectors; expected {', '.join(self.channels)}")
        return dict(zip(self.channels, outputs, strict=True))

    @functools.cached_property
    def content_hash(self) -> str:
        """Hash of address, name, configuration and parameter names. Changes on the server cannot be detected."""
        return digest(
            "um-bridge", self.url, self.name, self.config, self.send_record, self.free, self.channels, self.version
        )

    def __repr__(self) -> str:
        return f"UMBridgeModel({self.url}, {self.name}: {', '.join(self.free)} -> {', '.join(self.channels)})"


@functools.cache
def _check_name(url: str, name: str) -> None:
    """Refuse a model that the server does not offer; this is checked once per process."""
    offered = _answer(url, "Info", None, "models")
    if name not in offered:
        raise SolverError(f"the server at {url} has no model '{name}'; it offers {', '.join(map(str, offered))}")


def _answer(url: str, what: str, question: Mapping[str, Any] | None, key: str) -> Any:
    """Send a request to a server. If the reply is an error, report its status and first words."""
    try:
        import requests
    except ImportError:
        raise SolverError("UM-Bridge is not installed; install it: pip install 'structid[umbridge]'") from None
    try:
        to = f"{url}/{what}"
        response = requests.get(to) if question is None else requests.post(to, json=question)
    except requests.RequestException as problem:
        raise SolverError(f"the server at {url} did not answer: {type(problem).__name__}: {problem}") from None
    # Servers write diverged runs in many ways, most of which are not valid JSON. Python's reader accepts NaN.
    text = NOT_A_NUMBER.sub("NaN", response.text)
    try:
        answer = json.loads(text)
    except ValueError:
        answer = None
    if isinstance(answer, dict) and "error" in answer:
        error = answer["error"]
        description = f"{error.get('type')}: {error.get('message')}" if isinstance(error, dict) else str(error)
        raise SolverError(f"the server at {url} answered with an error: {description}")
    if response.status_code >= 400 or not isinstance(answer, dict) or key not in answer:
        words = " ".join(re.sub(r"<[^>]*>", " ", response.text).split())[:FIRST_WORDS] or "nothing"
        raise SolverError(f"the server at {url} answered {what} with HTTP status {response.status_code}: {words}")
    return answer[key]


class Served:
    """Methods that ``umbridge.serve_models`` requires of a model in addition to its values."""

    def __init__(self, name: str, differentiable: bool) -> None:
        self.name, self._differentiable = name, differentiable

    def supports_evaluate(self) -> bool:
        """Whether the model can be evaluated."""
        return True

    def supports_gradient(self) -> bool:
        """Whether products of the transposed Jacobian with a vector are available."""
        return self._differentiable

    def supports_apply_jacobian(self) -> bool:
        """Whether products of the Jacobian with a vector are available."""
        return self._differentiable

    def supports_apply_hessian(self) -> bool:
        """Whether products of second derivatives with vectors are available."""
        return False


class ServedModel(Served):
    """A structid model with the interface that ``umbridge.serve_models`` requires."""

    def __init__(self, model: Model, excitation: Excitation, name: str = "forward") -> None:
        super().__init__(name, model.traceable)
        self.model, self.excitation = model, excitation

    def get_input_sizes(self, config: Mapping[str, Any]) -> list[int]:
        """Return the lengths of the input vectors: one vector with the free parameters in SI."""
        return [len(self.model.free)]

    def get_output_sizes(self, config: Mapping[str, Any]) -> list[int]:
        """Return the lengths of the output vectors, one vector for each channel."""
        return [len(self._driven_by(config))] * len(self.model.channels)

    def __call__(self, parameters: list[list[float]], config: Mapping[str, Any]) -> list[list[float]]:
        """Run the model once.

        A failed run returns its results up to the failure, because the protocol cannot transmit NaN. The vectors are then too
        short, and the protocol reports an error with both lengths.
        """
        excitation = self._driven_by(config)
        values = self.model.simulate(np.array(parameters, dtype=float), excitation).values[0]
        finite = np.isfinite(values).all(axis=1)
        usable: list[list[float]] = values[: len(values) if finite.all() else int(np.argmin(finite))].T.tolist()
        return usable

    def apply_jacobian(
        self, out_wrt: int, in_wrt: int, parameters: list[list[float]], vec: list[float], config: Mapping[str, Any]
    ) -> list[float]:
        """Compute the derivative of one channel along a direction in parameter space."""
        import jax

        channel = self._channel(out_wrt, config)
        point, direction = np.array(parameters[0], dtype=float), np.array(vec, dtype=float)
        return [float(value) for value in jax.jvp(channel, (point,), (direction,))[1]]

    def gradient(
        self, out_wrt: int, in_wrt: int, parameters: list[list[float]], sens: list[float], config: Mapping[str, Any]
    ) -> list[float]:
        """Compute the gradient of a weighted sum of one channel's samples with respect to the parameters."""
        import jax

        _, pull_back = jax.vjp(self._channel(out_wrt, config), np.array(parameters[0], dtype=float))
        return [float(value) for value in pull_back(np.array(sens, dtype=float))[0]]

    def _channel(self, number: int, config: Mapping[str, Any]) -> Any:
        """Return the history of one channel as a function of the parameters, inside JAX."""
        model = as_traceable(self.model, f"derivatives of {self.name}")
        record = self._driven_by(config)
        model.check_excitation(record)
        excitation = model.traced(record)
        return lambda theta: model.response(theta[None], excitation)[0][:, number, 0]

    def _driven_by(self, config: Mapping[str, Any]) -> Excitation:
        record = config.get("record")
        if record is None:
            return self.excitation
        return type(self.excitation)(record["values"], record["dt"], record.get("name", "request"))


def check_address(host: str, port: int) -> None:
    """Refuse an address on which this machine cannot listen."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((address[0], port, *address[2:]))
    except (OSError, UnicodeError, OverflowError) as cause:
        raise InputError(
            "structid serve",
            f"this machine cannot listen at the address {host}:{port} ({cause})",
            "an address of this machine, such as 127.0.0.1, and an unused port from 1 to 65535",
        ) from None


def is_this_machine(host: str) -> bool:
    """Whether an address is reachable from this machine only."""
    return all(ipaddress.ip_address(result[4][0]).is_loopback for result in socket.getaddrinfo(host, None))


def serve(models: Sequence[ServedModel], port: int = 4242, host: str = "127.0.0.1") -> None:
    """Serve models over HTTP until the process is stopped."""
    try:
        import umbridge
        from aiohttp import web
    except ImportError:
        raise InputError(
            "structid serve",
            "UM-Bridge is not installed",
            "the extra 'umbridge'",
            "Run: pip install 'structid[umbridge]'.",
        ) from None
    # umbridge listens on every interface and has no option for the address. Therefore its HTTP server receives the address here.
    with patch.object(web, "run_app", functools.partial(web.run_app, host=host)):
        umbridge.serve_models(list(models), port)
