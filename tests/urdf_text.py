"""Small robots as URDF text."""

LIMIT = '<limit lower="-2" upper="2" effort="80" velocity="3"/>'


def link(
    name: str, mass: float | str = 1.0, moments: tuple[float, ...] = (0.02, 0.02, 0.02), centre: float = 0.2
) -> str:
    """Return a link whose centre of mass is so far along z."""
    xx, yy, zz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {centre}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT) -> str:
    """Return a joint about y, 0.4 m along the parent."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>{inside}</joint>'
    )


def robot(*parts: str) -> str:
    """Return the file's text."""
    return f'<robot name="arm">{"".join(parts)}</robot>'


def arm(upper: str = "", fore: str = "", shoulder: str = "", elbow: str = "", more: str = "") -> str:
    """Two links on a base, upright at zero; any of the parts may be replaced, and others added."""
    return robot(
        link("base"),
        upper or link("upper"),
        fore or link("fore"),
        shoulder or joint("shoulder", "base", "upper"),
        elbow or joint("elbow", "upper", "fore"),
        more,
    )
