"""Forward kinematics of a robot, from the kinematic model in its description."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InvalidSpec
from drivers.spec import RobotSpec

if TYPE_CHECKING:  # loaded when it is needed: `import drivers` stays cheap
    import mujoco

Array = NDArray[np.float64]

EE_SITE = "ee"
"""Site of the end effector in a kinematic model; its pose is `RobotState.ee_pos` and `ee_quat`."""
GUARD_PREFIX = "guard:"
"""Prefix of the names of guard sites: spheres of the site's size that enclose parts of the arm."""


class Kinematics:
    """Forward kinematics of the end effector and the guarded parts of the arm.

    The model is MJCF text without files: the joints of `RobotSpec.joint_names` in that order
    and no others, a site ``ee``, and a site ``guard:...`` for each part of the arm that must
    stay out of `Limits.keep_out`.

    Attributes:
        model: The compiled model of the arm.
        guard_radii: Radius of each guarded sphere, m. ``(n_guards,)``
        guarded_sites: Sites of the model in the order of `guarded_points`. ``(1 + n_guards,)``
    """

    def __init__(self, spec: RobotSpec) -> None:
        """Compile the model of a robot.

        Args:
            spec: The robot.

        Raises:
            InvalidSpec: If the model cannot be compiled, or does not have the spec's joints.
        """
        import mujoco

        self.model = _compile(spec)
        names = [self.model.site(site).name for site in range(self.model.nsite)]
        if EE_SITE not in names:
            raise InvalidSpec(f"kinematic model of {spec.name} has no site {EE_SITE!r}; add one")
        self._ee = names.index(EE_SITE)
        guards = [i for i, name in enumerate(names) if name.startswith(GUARD_PREFIX)]
        self.guarded_sites = np.array([self._ee, *guards])
        self.guard_radii: Array = self.model.site_size[guards, 0].copy()
        self._data = mujoco.MjData(self.model)
        self._jacp = np.zeros((3, self.model.nv))
        model_and_data = (self.model, self._data)
        self._forward = partial(mujoco.mj_kinematics, *model_and_data)
        self._differentiate = (
            partial(mujoco.mj_comPos, *model_and_data),
            partial(mujoco.mj_jacSite, *model_and_data, self._jacp, None, self._ee),
        )

    def ee_pos(self, q: Array) -> Array:
        """Return the position of the end effector in the spec's frame, m. ``(3,)``

        Args:
            q: Joint positions. ``(n_joints,)``
        """
        self._place(q)
        return np.array(self._data.site_xpos[self._ee])

    def ee_jacobian(self, q: Array) -> Array:
        """Return the end effector's linear velocity per joint velocity. ``(3, n_joints)``

        Args:
            q: Joint positions. ``(n_joints,)``
        """
        self._place(q)
        for step in self._differentiate:
            step()
        return self._jacp.copy()

    def guarded_points(self, q: Array) -> Array:
        """Return the end effector, then the centre of each guarded sphere, m.

        Args:
            q: Joint positions. ``(n_joints,)``

        Returns:
            In the spec's frame. ``(1 + n_guards, 3)``
        """
        self._place(q)
        return np.array(self._data.site_xpos[self.guarded_sites])

    def _place(self, q: Array) -> None:
        self._data.qpos[:] = q
        self._forward()


def _compile(spec: RobotSpec) -> mujoco.MjModel:
    import mujoco

    text = spec.kinematic_model
    try:
        # A description may come from another machine: it must not open files on this one.
        for element in ElementTree.fromstring(text).iter():
            if element.tag in ("include", "plugin", "extension") or "file" in element.attrib:
                raise InvalidSpec(
                    f"kinematic model of {spec.name} has <{element.tag}>, allowed: one MJCF text "
                    "that refers to no files and plugins"
                )
        model = mujoco.MjModel.from_xml_string(text)
    except (ElementTree.ParseError, ValueError) as error:
        if isinstance(error, InvalidSpec):
            raise
        reason = " ".join(str(error).split())
        raise InvalidSpec(f"kinematic model of {spec.name} is not valid MJCF: {reason}") from error
    names = tuple(model.joint(joint).name for joint in range(model.njnt))
    if names != spec.joint_names or model.nq != model.njnt:
        raise InvalidSpec(
            f"kinematic model of {spec.name} has joints {', '.join(names)}; allowed: hinges and "
            f"slides named {', '.join(spec.joint_names)}, in this order"
        )
    if len(spec.home.q) != model.nq:
        raise InvalidSpec(
            f"home of {spec.name} has {len(spec.home.q)} joint positions, allowed: {model.nq}, "
            "one for each joint of its kinematic model"
        )
    return model
