"""Where the archives are: the public ones, or mirrors of them with the same layout."""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from urllib.parse import urlsplit

from mgsgraph.errors import InputError
from mgsgraph.files.decoding import LARGEST_TOML, toml_table
from mgsgraph.files.opening import read_text
from mgsgraph.record import Record

VARIABLE = "MGSGRAPH_MIRRORS"
"""Environment variable with the path of a file of mirrors."""
_SCHEMES = ("https", "http")


@dataclass(frozen=True, slots=True)
class Archives(Record):
    """Addresses (http or https) under which the archives' own layout begins; each ends in a slash.

    Examples
    --------
    >>> archives = mgsgraph.Archives(kernels="https://mirror.example.org/naif/")
    >>> archives.kernels
    'https://mirror.example.org/naif/'
    >>> mgsgraph.Archives.under("http://localhost:8000").pedr
    'http://localhost:8000/pedr/'
    """

    images: str = "https://planetarydata.jpl.nasa.gov/img/data/mgs-m-moc-na_wa-2-sdp-l0-v1.0/"
    """MOC standard data products: volumes mgsc_NNNN/ (PDS Imaging node)."""
    kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mgs-m-spice-6-v1.0/mgsp_1000/data/"
    """SPICE kernels of MGS: spk/, ck/, sclk/, ik/, fk/, pck/ (NAIF)."""
    leap_seconds: str = "https://naif.jpl.nasa.gov/pub/naif/generic_kernels/lsk/"
    """NAIF's generic leap seconds kernels."""
    pedr: str = "https://pds-geosciences.wustl.edu/mgs/mgs-m-mola-3-pedr-l1a-v1/mgsl_21xx/data/"
    """MOLA's profiles: apNNxxx/apNNNNNl.b (PDS Geosciences node)."""
    megdr: str = "https://pds-geosciences.wustl.edu/mgs/mgs-m-mola-5-megdr-l3-v1/mgsl_300x/"
    """MOLA's grids: meg004/, meg016/, meg128/ (PDS Geosciences node)."""
    ctx: str = "https://planetarydata.jpl.nasa.gov/img/data/mro/ctx/"
    """CTX: volumes mrox_NNNN/data/ (PDS Imaging node)."""
    lroc: str = "https://pds.lroc.im-ldi.com/data/LRO-L-LROC-2-EDR-V1.0/"
    """LROC: volumes LROLRC_NNNN/DATA/ (LROC node)."""
    hrsc: str = "https://pds-geosciences.wustl.edu/mex/mex-m-hrsc-3-rdr-v4/"
    """HRSC: volumes mexhrs_NNNN/data/ORBIT/ (PDS Geosciences node)."""
    mro_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mro-m-spice-6-v1.0/mrosp_1000/"
    """SPICE kernels of MRO: extras/mk/, data/ (NAIF)."""
    lro_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/lro-l-spice-6-v1.0/lrosp_1000/"
    """SPICE kernels of LRO."""
    mex_kernels: str = "https://naif.jpl.nasa.gov/pub/naif/pds/data/mex-e_m-spice-6-v2.0/mexsp_2000/"
    """SPICE kernels of Mars Express."""
    isis: str = "https://asc-isisdata.s3.us-west-2.amazonaws.com/usgs_data/"
    """ISIS's own data: addenda of instrument kernels, MISSION/kernels/iak/ (USGS)."""
    ode: str = "https://oderest.rsl.wustl.edu/"
    """REST services of the Orbital Data Explorer: live2 (products), livegds (laser shots over a box)."""

    def __post_init__(self) -> None:
        for field in fields(self):
            address = getattr(self, field.name)
            require_address(address, f"archives, {field.name}")
            if not address.endswith("/"):
                object.__setattr__(self, field.name, f"{address}/")

    @classmethod
    def under(cls, address: str) -> "Archives":
        """All of them below one address, in folders called as the fields are: images/, kernels/ ..."""
        require_address(address, "mirror")
        return cls(*(f"{address.rstrip('/')}/{field.name}/" for field in fields(cls)))

    @classmethod
    def read(cls, path: Path) -> "Archives":
        """From a TOML file, ``kernels = "https://..."`` and so on; the public ones for keys that it lacks.

        Raises
        ------
        InputError
            A file that can't be read or is no TOML, a key that is no archive, or no address of http or https.
        """
        table = toml_table(read_text(path, limit=LARGEST_TOML), str(path))
        known = [field.name for field in fields(cls)]
        for key, value in table.items():
            if key not in known:
                raise InputError(f"{path}, {key}", "no archive of that name", ", ".join(known))
            if not isinstance(value, str):
                raise InputError(f"{path}, {key}", repr(value)[:60], "an address in quotation marks")
            require_address(value, f"{path}, {key}")
        return cls(**table)

    @classmethod
    def chosen(cls, mirror: str | None = None, mirrors: Path | None = None) -> "Archives":
        """Those of `mirror` (one address) or of the file `mirrors`, or of the file that $MGSGRAPH_MIRRORS names, or the
        public ones.
        """
        if mirror is not None and mirrors is not None:
            raise InputError("mirrors", "both one address and a file of them", "one of the two")
        if mirror is not None:
            return cls.under(mirror)
        named = mirrors or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
        return cls() if named is None else cls.read(named)


def require_address(address: str, where: str) -> None:
    """Raise InputError unless it is an address of http or https with a host."""
    try:
        parts = urlsplit(address)
        sound = parts.scheme in _SCHEMES and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:  # a port that is no number, brackets that don't close
        sound = False
    if not sound or parts.query or parts.fragment:
        raise InputError(where, repr(address), "an address such as https://example.org/data/")
    if parts.username is not None or parts.password is not None:  # they would stand in the lock file
        raise InputError(where, "an address with a name or password", "one without", "put them into ~/.netrc")
