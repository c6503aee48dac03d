"""Images of CTX, LROC NAC and HRSC out of archives laid out as the public ones, made up in memory."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import flaky_archive
import pytest
from flaky_archive import Flaky

from mgsgraph.case.case_file import decode
from mgsgraph.errors import InputError
from mgsgraph.fetch.camera_search import dates_in
from mgsgraph.fetch.download import RetryPolicy
from mgsgraph.fetch.folder import Fetched, fetch_images
from mgsgraph.fetch.needs import CTX, HRSC, LROC_NAC, Archives, CameraProduct
from mgsgraph.fetch.store import Lock
from mgsgraph.files.labels.kernels import members

QUICK = RetryPolicy(tries=2, first_wait=0.001, longest_wait=0.01, connecting=20.0, reading=20.0)
B10, NAC, H5270 = "B10_013341_1010_XN_79S172W", "M103595705LE", "h5270_0000_ir2"
SHOTS = "output/20260819t1202/{}_79S_80S_pts_csv.csv"


def label(product: str, instrument: str, start: str, stop: str, more: str = "") -> bytes:
    """An image of one record with its label at its head, as in the mission's data."""
    text = (
        f"PDS_VERSION_ID = PDS3\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = 2048\r\nFILE_RECORDS = 2\r\n"
        f"INSTRUMENT_ID = {instrument}\r\nPRODUCT_ID = \"{product}\"\r\nSTART_TIME = {start}\r\nSTOP_TIME = {stop}\r\n"
        f"{more}END\r\n"
    )
    return text.encode().ljust(2048) + bytes(2048)


def said(product: str, url: str, **box: float) -> bytes:
    """ODE's answer for one product."""
    record = {"pdsid": product, "LabelURL": url, **{key: str(value) for key, value in box.items()}}
    return json.dumps({"ODEResults": {"Status": "Success", "Products": {"Product": record}}}).encode()


def kernels(
    root: str, mk: str, names: tuple[str, ...], data: str = "data/", folder: str = "extras/mk/"
) -> dict[str, bytes]:
    listed = "\n".join(f"'$KERNELS/{name}'" for name in names)
    paths = "PATH_VALUES = ('./data')\nPATH_SYMBOLS = ('KERNELS')"
    text = f"KPL/MK\n\\begindata\n{paths}\nKERNELS_TO_LOAD = (\n{listed}\n)\n"
    found = {f"{root}{folder}{mk}": text.encode()}
    for name in names:
        kind = {"bsp": b"DAF/SPK ", "bc": b"DAF/CK  ", "bpc": b"DAF/PCK "}.get(name.lower().rpartition(".")[2])
        text = b"KPL/X\n\\begindata\nA = 1\n" + name.encode()
        body = text if kind is None else (kind + name.encode()).ljust(1024, b"\0")
        found[f"{root}{data}{name}"] = body
    return found


def cover(start: str, stop: str) -> bytes:
    return f"PDS_VERSION_ID = PDS3\r\nSTART_TIME = {start}\r\nSTOP_TIME = {stop}\r\nEND\r\n".encode()


def shots_asked(data_set: str, *box: str) -> str:
    sides = "".join(f"&{n}={v}" for n, v in zip(("minlat", "maxlat", "westernlon", "easternlon"), box, strict=True))
    return f"ode/livegds/?query={data_set}&results=v&output=JSON{sides}"


def archive_files() -> dict[str, bytes]:
    """A CTX, a NAC and an HRSC image: volumes, kernels of their time and of others, answers of ODE."""
    box = {"Minimum_latitude": -79.5, "Maximum_latitude": -78.5, "Westernmost_longitude": 187.0}
    lroc = "https://pds.lroc.im-ldi.com/data/LRO-L-LROC-2-EDR-V1.0"
    nac_url = f"{lroc}/LROLRC_0001/DATA/COM/2009211/NAC/M103595705LE.xml"
    found = {
        f"ode/{CTX.query.format(B10)}": said(
            B10, f"https://planetarydata.jpl.nasa.gov/img/data/mro/ctx/mrox_1232/data/{B10}.IMG",
            Easternmost_longitude=189.0, **box,
        ),
        f"ode/{LROC_NAC.query.format(NAC.lower())}": said(f"nac.{NAC.lower()}", nac_url),
        f"ctx/mrox_1232/data/{B10}.IMG": label(B10, "CTX", "2009-06-01T00:38:16.057", "2009-06-01T00:38:35.000"),
        f"lroc/LROLRC_0001/DATA/COM/2009211/NAC/{NAC}.IMG": label(
            NAC, "LROC", "2009-07-30T12:20:38.185", "2009-07-30T12:20:55.0", 'ORBIT_NUMBER = 410\r\n'
        ),
        f"hrsc/mexhrs_4000/data/5270/{H5270}.img": label(
            "H5270_0000_IR2.IMG", "HRSC", "2008-02-08T12:08:53.843Z", "2008-02-08T12:12:07Z",
            "FOOTPRINT_POINT_LATITUDE = (25.9, 12.5, 12.6)\r\nFOOTPRINT_POINT_LONGITUDE = (78.2, 76.9, 77.0)\r\n",
        ),
        shots_asked("molapedr", "-79.5200", "-78.4800", "186.9800", "189.0200"): json.dumps({"GDSResults": {
            "ResultFiles": {"ResultFile": {"URL": f"https://oderest.rsl.wustl.edu/{SHOTS.format('MOLA')}"}}
        }}).encode(),
        f"ode/{SHOTS.format('MOLA')}": b"long_East,lat_North\n187.0,-79.0\n",
    }  # fmt: skip
    found |= kernels("mro_kernels/", "mro_2009_v14.tm", (
        "lsk/naif0012.tls", "pck/pck00008.tpc", "sclk/mro_sclkscet_00082_65536.tsc", "fk/mro_v16.tf",
        "ik/mro_ctx_v11.ti",
        "spk/de421.bsp", "spk/mro_psp10.bsp", "spk/mro_psp11.bsp", "ck/mro_sc_psp_090519_090525.bc",
        "ck/mro_sc_psp_090526_090601.bc", "ck/mro_hga_psp_090526_090601.bc",
    ))  # fmt: skip
    found["mro_kernels/extras/mk/mro_2009_v09.tm"] = b"KPL/MK\n\\begindata\n"
    found["mro_kernels/data/spk/mro_psp10.lbl"] = cover("2009-01-01T00:00:00", "2009-04-01T00:00:00")
    found["mro_kernels/data/spk/mro_psp11.lbl"] = cover("2009-04-01T00:00:00", "2009-07-01T00:00:00")
    found |= kernels("lro_kernels/", "lro_2009_v17.tm", (
        "lsk/naif0012.tls", "pck/moon_pa_de421_1900_2050.bpc", "fk/lro_frames_2014049_v01.tf",
        "spk/lrorg_2009169_2009258_v01.bsp", "spk/lrorg_2009258_2009349_v01.bsp", "ck/lrosc_2009182_2009213_v01.bc",
        "ck/lrolc_2009181_2009213_v01.bc", "ck/lrosa_2009182_2009213_v01.bc",
    ))  # fmt: skip
    for name in ("lro/kernels/iak/lro_instrumentAddendum_v04.ti", "mro/kernels/iak/mroctxAddendum005.ti"):
        found[f"isis/{name}"] = b"KPL/IK\n\\begindata\nB = 1\n"
    found |= kernels("mex_kernels/", "MEX_V16.TM", (
        "LSK/NAIF0012.TLS", "SPK/ORMM_T19_080201000000_00474.BSP", "SPK/ORMM_T19_080301000000_00484.BSP",
        "CK/ATNM_MEASURED_080101_090101_V03.BC", "CK/ATNM_MEASURED_090101_100101_V03.BC",
    ), "DATA/", "EXTRAS/MK/")  # fmt: skip
    for month, stop in ((2, "2008-03-01T00:00:00"), (3, "2008-04-01T00:00:00")):
        name = f"mex_kernels/DATA/SPK/ORMM_T19_080{month}01000000_004{74 if month == 2 else 84}.LBL"
        found[name] = cover(f"2008-0{month}-01T00:00:00", stop)
    return found


@pytest.fixture(scope="module")
def _server() -> Iterator[Flaky]:
    with flaky_archive.served() as archive:
        yield archive


@pytest.fixture
def archive(_server: Flaky) -> Flaky:
    _server.files = archive_files()
    for memory in (_server.faults, _server.stays, _server.asked, _server.sent):
        memory.clear()
    return _server


def fetch(archive: Flaky, folder: Path, *images: str, **more: Any) -> Fetched:
    return fetch_images(images, folder, archives=Archives.under(archive.address), retry=QUICK, terrain="none", **more)


@pytest.mark.parametrize(
    ("image", "kernels_of_its_time", "left"),
    [
        (B10, ("de421.bsp", "mro_psp11.bsp", "mro_sc_psp_090526_090601.bc"), "mro_psp10.bsp"),
        (NAC, ("lrorg_2009169_2009258_v01.bsp", "lrosc_2009182_2009213_v01.bc", "lrolc_2009181_2009213_v01.bc"),
         "lrosa_2009182_2009213_v01.bc"),
        (H5270, ("ORMM_T19_080201000000_00474.BSP", "ATNM_MEASURED_080101_090101_V03.BC"),
         "ATNM_MEASURED_090101_100101_V03.BC"),
    ],
)  # fmt: skip
def test_an_image_and_the_kernels_of_its_time(
    archive: Flaky, tmp_path: Path, image: str, kernels_of_its_time: tuple[str, ...], left: str
) -> None:
    fetched = fetch(archive, tmp_path / "d", image)
    (needs,) = fetched.images
    folder = tmp_path / "d"

    assert tuple(Path(one).name for one in needs.kernels if "/spk/" in one.lower() or "/ck/" in one.lower()) == (
        kernels_of_its_time
    )
    assert not (folder / "kernels" / left).exists()
    assert (folder / needs.image_path).is_file()
    case = decode(fetched.case)
    assert [(one.name, one.label) for one in case.images] == [(image.upper(), needs.image_path)]
    assert case.spice is not None
    loaded = members(folder / case.spice.kernels[0])
    assert [path.name for path in loaded] == [Path(one).name for one in (*needs.kernels, needs.addendum) if one]
    assert bool(needs.addendum) == (image != H5270)
    assert any("hrscAddendum004.ti is not" in note for note in needs.notes) == (image == H5270)
    lock = Lock.read(folder)
    assert all(map(lock.whole, lock.files))
    assert lock.images[image.upper()] == needs

    archive.asked.clear()
    assert fetch(archive, folder, image).brought == {}
    assert not archive.asked


def test_shots_of_the_orbital_data_explorer(archive: Flaky, tmp_path: Path) -> None:
    fetched = fetch(archive, tmp_path / "d", B10)
    assert (tmp_path / "d" / f"shots/{B10.lower()}_pts_csv.csv").read_bytes().startswith(b"long_East")
    assert f"shots/{B10.lower()}_pts_csv.csv" in fetched.case.read_text(encoding="utf-8")
    assert fetched.images[0].box == (-79.5, -78.5, 187.0, 189.0)
    lunar = fetch(archive, tmp_path / "e", NAC)
    assert not lunar.images[0].shots
    assert lunar.images[0].orbit == 410
    assert [note for note in lunar.notes if "no laser shots" in note]


def test_a_file_that_is_damaged_is_fetched_again(archive: Flaky, tmp_path: Path) -> None:
    fetch(archive, tmp_path / "d", NAC)
    damaged = tmp_path / "d" / "kernels" / "lrosc_2009182_2009213_v01.bc"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-1])
    assert set(fetch(archive, tmp_path / "d", NAC).brought) == {f"kernels/{damaged.name}"}
    assert damaged.read_bytes() == whole


def test_what_is_refused(archive: Flaky, tmp_path: Path) -> None:
    for images, found in (
        (("B11_013341_1010_XN_79S172W",), "not known to the Orbital Data Explorer"),
        (("H9999_0000_ND2",), "in none of mexhrs_4000"),
        ((B10, NAC), "several missions"),
        ((B10, "E02/00665"), "several missions"),
    ):
        with pytest.raises(InputError, match=found):
            fetch(archive, tmp_path / images[0], *images)
    fetch(archive, tmp_path / "d", B10)
    with pytest.raises(InputError, match="several missions"):
        fetch(archive, tmp_path / "d", NAC)
    assert list(Lock.read(tmp_path / "d").images) == [B10]
    for path in [name for name in archive.files if "/ck/mro_sc" in name]:
        archive.files["mro_kernels/extras/mk/mro_2009_v14.tm"] = archive.files[
            "mro_kernels/extras/mk/mro_2009_v14.tm"
        ].replace(Path(path).name.encode(), b"mro_sc_psp_080101_080102.bc")
    with pytest.raises(InputError, match="no CK that holds"):
        fetch(archive, tmp_path / "e", B10)
    del archive.files["mro_kernels/extras/mk/mro_2009_v14.tm"], archive.files["mro_kernels/extras/mk/mro_2009_v09.tm"]
    with pytest.raises(InputError, match="no meta-kernel"):
        fetch(archive, tmp_path / "f", B10)


def test_ids_and_dates_in_names() -> None:
    for text, camera in ((f"{B10}.IMG", CTX), (NAC.lower(), LROC_NAC), ("M1379255373RE", LROC_NAC), (H5270, HRSC),
                         ("h1995_0000_s13", HRSC)):  # fmt: skip
        product = CameraProduct.read(text)
        assert product is not None
        assert product.camera is camera
    assert CameraProduct.read("E02/00665") is None
    covered = dates_in("mro_sc_psp_090526_090601.bc")
    assert covered is not None
    assert (f"{covered.start:%Y-%m-%d}", f"{covered.stop:%Y-%m-%d}") == ("2009-05-26", "2009-06-02")
    assert dates_in("moon_pa_de421_1900_2050.bpc") is None
    assert dates_in("mro_psp11.bsp") is None
