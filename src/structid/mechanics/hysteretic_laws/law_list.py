"""All hysteretic laws that a model can name. To add a law, write a file with its class, and add a line here."""

from __future__ import annotations

from structid.core.errors import InputError, suggestion
from structid.mechanics.hysteretic_laws.base import HystereticLaw
from structid.mechanics.hysteretic_laws.bilinear import Bilinear
from structid.mechanics.hysteretic_laws.bouc_wen_baber_noori import BoucWenLaw
from structid.mechanics.hysteretic_laws.elastic_plastic import ElasticPlastic
from structid.mechanics.hysteretic_laws.giuffre_menegotto_pinto import GiuffreMenegottoPinto
from structid.mechanics.hysteretic_laws.ibarra_peak_oriented import IbarraPeakOriented
from structid.mechanics.hysteretic_laws.ibarra_pinching import IbarraPinching
from structid.mechanics.hysteretic_laws.linear import Linear
from structid.mechanics.hysteretic_laws.masing import Masing
from structid.mechanics.hysteretic_laws.masing_flag import MasingFlag
from structid.mechanics.hysteretic_laws.pivot import Pivot
from structid.mechanics.hysteretic_laws.ramberg_osgood import RambergOsgood
from structid.mechanics.hysteretic_laws.self_centering import SelfCentering
from structid.mechanics.hysteretic_laws.slip_lock import SlipLock
from structid.mechanics.hysteretic_laws.voce_chaboche import VoceChaboche

LAWS: dict[str, type[HystereticLaw]] = {
    law.word: law
    for law in (
        Linear,
        ElasticPlastic,
        Bilinear,
        RambergOsgood,
        GiuffreMenegottoPinto,
        VoceChaboche,
        SelfCentering,
        BoucWenLaw,
        SlipLock,
        Masing,
        MasingFlag,
        Pivot,
        IbarraPeakOriented,
        IbarraPinching,
    )
}
"""Laws by their names in study files."""
INELASTIC = tuple(word for word in LAWS if word != Linear.word)
"""Names of the laws of a specimen that dissipates energy."""


def law_of(where: str, given: str | HystereticLaw) -> HystereticLaw:
    """Return a law from its name, or the law itself."""
    if isinstance(given, HystereticLaw):
        return given
    if given not in LAWS:
        raise InputError(where, f"'{given}'", ", ".join(LAWS), suggestion(str(given), tuple(LAWS)))
    return LAWS[given]()
