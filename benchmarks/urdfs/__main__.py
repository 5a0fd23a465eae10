"""Import real URDFs, export them with departures of a calibration, and load them back.

The packages of the files (`packages.txt`, 235 MB with meshes) are installed beside the results,
once; they are too large for every set-up, and their licences keep the files out of this repository.
Writes `benchmarks/urdfs.md`.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from ikpy.chain import Chain as IkpyChain

from pa10cal.arm.branches import branches_of
from pa10cal.arm.chain import BASE, TOOL, Chain, end_pose
from pa10cal.arm.ur_calibration import ur_kinematics
from pa10cal.arm.urdf_import import arm_from_urdf_text
from pa10cal.arm.urdf_reading import parse_urdf
from pa10cal.arm.urdf_writing import UrdfSource, patched_urdf
from pa10cal.files.output import write_text

HERE = Path(__file__).parent
FOLDER = Path("results/urdfs")
#: Files of arms, and their tips where a robot branches.
ARMS = {
    "ur3e.urdf": "tool0",
    "ur5e.urdf": "tool0",
    "ur3_robot.urdf": "tool0",
    "ur5_robot.urdf": "tool0",
    "ur10_robot.urdf": "tool0",
    "panda.urdf": "panda_link8",
    "xarm7.urdf": None,
    "z1.urdf": None,
    "so100.urdf": None,
    "talos_left_arm.urdf": "gripper_left_base_link",
    "tiago_no_hand.urdf": "arm_7_link",
    "baxter.urdf": "left_hand_link",
    "gen3_6dof.urdf": None,
    "gen3_7dof.urdf": None,
    "gen3lite.urdf": None,
    "iiwa7.urdf": None,
    "irb140.urdf": None,
    "kr120r2500pro.urdf": None,
    "kr16_2.urdf": None,
    "kr210l150.urdf": "tool0",
    "lbr_iiwa_14_r820.urdf": None,
    "puma560_robot.urdf": None,
    "al5d_robot.urdf": None,
}
#: What no kinematics needs, and loaders look for meshes in or stumble over.
SHAPES = ("visual", "collision", "mimic", "dynamics", "inertial")
HEAD = (
    "| file | joints | import [m] | pinocchio [m] | ikpy [m] | names, limits, shapes | branches |",
    "| --- | --- | --- | --- | --- | --- | --- |",
)


def main() -> None:
    packages = FOLDER / "packages"
    if not packages.is_dir():
        pip = [sys.executable, "-m", "pip", "--quiet", "install", "--no-deps"]
        pins = ["--requirement", str(HERE / "packages.txt")]
        subprocess.run([*pip, "--target", str(packages), *pins], check=True)
    found = {path.name: path for path in sorted(packages.rglob("*.urdf"), reverse=True)}
    rows = [row(found[name], tip) for name, tip in ARMS.items()]
    lines = [
        "# Real URDFs",
        "",
        "`make urdfs`: each file is imported, its arm is given departures of about a millimetre",
        "and a milliradian, and it is exported as `pa10cal export` does it. Columns: largest",
        "difference of forward kinematics of the import from pinocchio's; of the exported file, as",
        "pinocchio and as ikpy load it, from the calibrated chain; whether all but origins stayed;",
        "whether the branches of inverse kinematics are known in closed form.",
        "",
        *HEAD,
        *rows,
    ]
    write_text(HERE.parent / "urdfs.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


def row(path: Path, tip: str | None) -> str:
    text = path.read_text(encoding="utf-8-sig")
    imported = arm_from_urdf_text(text, path.stem, tip=tip, where=path.name)
    arm, chain = imported.arm, Chain.of(imported.arm)
    rng = np.random.default_rng(1)
    at = chain.nominal + rng.normal(0, 1e-3, len(chain.nominal))
    at[chain.columns(BASE + TOOL)] = 0.0
    source = UrdfSource(text, path.name, imported.base, imported.tip)
    exported = patched_urdf(source, chain, at, {}, "departures made up")
    q = rng.uniform(*np.clip(arm.limits_rad, -3.0, 3.0).T, (5, arm.n))
    coordinates = np.tile(at, (len(q), 1))
    coordinates[:, chain.joint_columns] += q
    wanted = end_pose(chain, coordinates)
    flange = "flange" if 'link name="flange_pa10cal"' not in exported else "flange_pa10cal"
    by = [
        f"{np.abs(loader(exported, imported, flange, q) - wanted).max():.0e}"
        for loader in (by_pinocchio, by_ikpy)
    ]
    kept = "kept" if without_origins(text).items() <= without_origins(exported).items() else "LOST"
    known = "8" if branches_of(arm) else "searched"
    if ur_kinematics(chain, at):
        known += ", UR driver's file"
    off_m = imported.forward_kinematics_difference_m
    return f"| `{path.name}` | {arm.n} | {off_m:.0e} | {by[0]} | {by[1]} | {kept} | {known} |"


def by_pinocchio(text, imported, flange, q):
    model = pin.buildModelFromXML(bare(text))
    data, found = model.createData(), []
    for positions in q:
        at = pin.neutral(model)
        for name, value in zip(imported.joints, positions, strict=True):
            joint = model.joints[model.getJointId(f"joint {name}")]
            turning = joint.nq == 2
            at[joint.idx_q : joint.idx_q + joint.nq] = (
                [np.cos(value), np.sin(value)] if turning else value
            )
        pin.framesForwardKinematics(model, data, at)
        ends = [data.oMf[model.getFrameId(each)] for each in (imported.base, flange)]
        found.append(ends[0].actInv(ends[1]).homogeneous)
    return np.array(found)


def bare(text: str) -> str:
    """Return links and joints alone, joints named apart from links, which pinocchio wants."""
    root = parse_urdf(text).robot
    for parent in root.iter():
        for key in [key for key in parent.attrib if ":" in key]:
            del parent.attrib[key]
        for child in [child for child in parent if ":" in child.tag]:
            parent.remove(child)
    for element in list(root):
        if element.tag not in ("link", "joint"):
            root.remove(element)
            continue
        for child in list(element):
            if child.tag in SHAPES:
                element.remove(child)
        if element.tag == "joint":
            element.set("name", f"joint {element.get('name')}")
    return ElementTree.tostring(root, encoding="unicode")


def by_ikpy(text, imported, flange, q):
    """Load the path from the base to the flange; other children are cut off, as ikpy wants it."""
    root = parse_urdf(bare(text)).robot
    carriers = {j.find("child").get("link"): j for j in root.findall("joint")}
    kept, link = [], flange
    while link != imported.base and link in carriers:
        kept.append(carriers[link])
        link = carriers[link].find("parent").get("link")
    top = link
    for joint in root.findall("joint"):
        if joint not in kept:
            root.remove(joint)
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / "loaded.urdf"
    path.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        chain = IkpyChain.from_urdf_file(str(path), base_elements=[top], symbolic=False)
    names = [link.name for link in chain.links]
    found, T_top_base = [], np.eye(4)
    if top != imported.base:  # a base beside the arm
        whole = pin.buildModelFromXML(bare(text))
        data = whole.createData()
        pin.framesForwardKinematics(whole, data, pin.neutral(whole))
        ends = [data.oMf[whole.getFrameId(each)] for each in (top, imported.base)]
        T_top_base = ends[0].actInv(ends[1]).homogeneous
    for positions in q:
        at = np.zeros(len(names))
        for name, value in zip(imported.joints, positions, strict=True):
            at[names.index(f"joint {name}")] = value
        found.append(np.linalg.inv(T_top_base) @ chain.forward_kinematics(at))
    return np.array(found)


def without_origins(text: str) -> dict[tuple[str, str], str]:
    root = parse_urdf(text).robot
    for joint in root.findall("joint"):
        for origin in joint.findall("origin"):
            joint.remove(origin)
    return {
        (each.tag, each.get("name", "")): "".join(ElementTree.tostring(each, "unicode").split())
        for each in root
    }


if __name__ == "__main__":
    main()
