"""The record and the measurement."""

from __future__ import annotations

import functools

import numpy as np

from structid.core.units import factor
from structid.figures import response as figures
from structid.ground_motion.record import GroundMotion
from structid.models.hysteretic.loop_lines import LoopLines
from structid.observation import Observation
from structid.report.material.material import PosteriorMaterial
from structid.report.section import Drawing, Picture, Section, nothing


def _drawings(material: PosteriorMaterial) -> list[Drawing]:
    records = [o.record for o in material.observations]
    several = range(len(records))
    # Several observations of one record, such as measurements on several floors, share one figure of the record.
    distinct = [index for index in several if not any(records[index] is earlier for earlier in records[:index])]
    drawings: list[Drawing] = [functools.partial(_record, material, index) for index in distinct]
    if not np.array_equal(material.raw_record.values, material.record.values):
        drawings.insert(1, functools.partial(_processing, material))
    drawings += [functools.partial(_coverage, material, index) for index in distinct if _incomplete(material, index)]
    drawings += [functools.partial(_measurement, material, index) for index in several]
    return drawings if material.loop is None else [*drawings, functools.partial(_loop, material.loop)]


def _record(material: PosteriorMaterial, index: int) -> Picture:
    record, name = material.observations[index].record, f"record{material.suffix(index)}"
    if isinstance(record, GroundMotion):
        return Picture(name, f"The record as used: {record}.", record.plot())
    columns = [signal.values / factor(signal.display_unit) for signal in record.signals]
    names, units = [signal.kind for signal in record.signals], [signal.display_unit for signal in record.signals]
    figure = figures.histories(record.time, columns, names, units)
    return Picture(name, f"Excitation of the structure: {record.name or record.kind}.", figure)


def _processing(material: PosteriorMaterial) -> Picture:
    scale = material.record.pga / material.raw_record.pga
    figure = material.raw_record.scale(scale).plot_filter(material.record)
    return Picture("processing", "The record before (scaled to the same peak) and after processing.", figure)


def _on_record(material: PosteriorMaterial, index: int) -> list[Observation]:
    record = material.observations[index].record
    return [o for o in material.observations if o.record is record]


def _incomplete(material: PosteriorMaterial, index: int) -> bool:
    """Whether a sensor on this record has its own time base, or values that are missing or left out."""
    sensors = _on_record(material, index)
    return any(o.sampling is not None or o.missing or any(o.left_out) for o in sensors)


def _coverage(material: PosteriorMaterial, index: int) -> Picture:
    sensors, record = _on_record(material, index), material.observations[index].record
    rows = [(" and ".join(o.channels), *o.stretches) for o in sensors]
    figure = figures.sensor_coverage((record.name or "record", 0.0, float(record.time[-1])), rows)
    words = "; ".join(f"{' and '.join(o.channels)}: {o.sensor_in_words}" for o in sensors if o.sensor_in_words)
    caption = f"Measured values on the time base of {record.name or 'the record'}. {words[:1].upper()}{words[1:]}."
    if any(o.sampling is not None and not o.sampling.on_samples for o in sensors):
        caption += " Between samples of the record, the response is a polynomial through the 6 nearest ones."
    return Picture(f"sensors{material.suffix(index)}", caption, figure)


def _measurement(material: PosteriorMaterial, index: int) -> Picture:
    observation, name = material.observations[index], f"measurement{material.suffix(index)}"
    units = [observation.channel_unit(c).display for c in observation.channels]
    columns = [observation.values[:, i] / factor(u) for i, u in enumerate(units)]
    measured = list(zip(columns, observation.channels, units, strict=True))
    record = observation.record
    figure = figures.measurement_on_record(
        record.time, (record.values, record.kind, record.unit), measured, measured_time=observation.time
    )
    caption = f"The measurement for {record.name}; right: the start of the strong motion."
    if sensor := observation.sensor_in_words:
        caption += f" Of this sensor: {sensor}. Without measured values: grey."
    return Picture(name, caption, figure)


def _loop(loop: LoopLines) -> Picture:
    return Picture("loop_of_the_priors", f"The measured loop from which priors were derived. {loop}", loop.plot())


SECTION = Section("data", "Data", _drawings, nothing)
