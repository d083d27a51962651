"""All file formats, in the order in which they are tried; text columns come last."""

from __future__ import annotations

from structid.data_files.agencies import (
    bbp,
    bhrc,
    cosmos,
    csmip,
    csmnc,
    cwa,
    deepsoil,
    eqsig,
    esm,
    geonet,
    knet,
    nsmn,
    peer,
    renadic,
    seismology,
    sigma,
    unam,
    usc,
    usgs_smc,
)
from structid.data_files.base import FileFormat
from structid.data_files.laboratory import array_files, excel, opensees, tdms

BINARY_FORMATS: tuple[FileFormat, ...] = (
    tdms.FORMAT,
    array_files.NPY,
    array_files.NPZ,
    array_files.MATLAB5,
    array_files.MATLAB73,
    excel.FORMAT,
    opensees.XML,
    seismology.SAC,
    seismology.MINISEED,
    opensees.BINARY,
)
"""Formats recognised by their bytes."""

TEXT_FORMATS: tuple[FileFormat, ...] = (
    knet.FORMAT,
    cosmos.SPECTRA,
    cosmos.FORMAT,
    cosmos.OTHER_VERSIONS,
    geonet.FORMAT,
    renadic.FORMAT,
    usc.FORMAT,
    usc.OTHER_VOLUMES,
    csmip.SPECTRA,
    csmip.FORMAT,
    bhrc.FORMAT,
    usgs_smc.SPECTRA,
    usgs_smc.FORMAT,
    nsmn.FORMAT,
    unam.FORMAT,
    cwa.FORMAT,
    csmnc.FORMAT,
    esm.FORMAT,
    sigma.SPECTRA,
    sigma.FORMAT,
    peer.FORMAT,
    bbp.FORMAT,
    deepsoil.FORMAT,
    eqsig.FORMAT,
)
"""Formats recognised by their text."""
