"""Source ``MillingForce``: the force of micro-milling on tool or table."""

from __future__ import annotations

from typing import ClassVar

from cosim.model import Experiment, Record, Source, parameter, variable
from fmus.physics.milling import Milling, Side


class MillingForce(Milling, Source):
    """Cutting force of a two-flute end mill with run-out, size effect and ploughing, from start_time on.

        h = max(0, n*a + own offset - last offset),   a = feed_per_tooth*sin(phi)
        f_t = K_t*(h/h_0)**-p_t*w*h,       f_n = K_n*(h/h_0)**-p_n*w*h                          where h >= h_min
        f_t = K_t*(h_min/h_0)**-p_t*w*h,   f_n = ploughing_factor*K_n*(h_min/h_0)**-p_n*w*h     where h < h_min
        f_x = -f_t*cos(phi) - f_n*sin(phi),   f_y = f_t*sin(phi) - f_n*cos(phi)

    for each tooth at its angle phi between entry_angle and exit_angle; force_x and force_y are the sums over the two
    teeth, w is axial_depth. A tooth finds the surface that was left n passages of a tooth before, by the last one that
    cut there; the offset of tooth 1 is run_out, that of tooth 2 -run_out.

    x is the feed direction. The forces are those on the tool, or with ``side`` table the opposite ones on the work.
    Tooth 1 enters at start_time, tooth 2 half a revolution later. Rigid tool and work; the chip is exact at any time
    without memory, with run-out and with ploughing.

    Source: Rubio, Ibeas & Luo, P-PI and super twisting sliding mode control schemes comparison for high-precision CNC
    machining, 2015; minimum chip thickness and size effect as in Vogler, DeVor & Kapoor, J. Manuf. Sci. Eng. 126
    (2004) 695-705; feed, run-out and specific forces are assumptions of the order of steel cut with 0.1 mm tools.
    """

    side: Side = parameter(Side.tool, "1", "Body on which the forces are given")

    class Output(Record):
        force_x: float = variable(0.0, "N", "Force in the feed direction", nominal=0.1)
        force_y: float = variable(0.0, "N", "Force across the feed direction", nominal=0.1)
        uncut_thickness: tuple[float, ...] = variable(
            (0.0, 0.0), "m", "Uncut chip thickness in front of the tooth", nominal=1e-6, display_unit="um"
        )

    experiment: ClassVar[Experiment] = Experiment(stop_time=0.1, step_size=1e-5)

    def output(self, t: float) -> Output:
        on_tool = self.forces_on_tool(t)
        sense = 1.0 if self.side is Side.tool else -1.0
        return self.Output(
            force_x=sense * on_tool.x, force_y=sense * on_tool.y, uncut_thickness=on_tool.uncut_thickness
        )
