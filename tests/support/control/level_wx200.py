"""Two WidowX-200 that hold the object level, grippers at each other: what an independent prototype has figures of.

One arm alone cannot hold the object and the other arm there, as it can in `two_wx200` as shipped.
"""

LEVEL = (
    "object.size_m=[0.135, 0.044, 0.044]",
    "object.inertia_kg_m2.yy=1.0416e-4",
    "object.inertia_kg_m2.zz=1.0416e-4",
    "trajectory.axis=[0.0, 1.0, 0.0]",
    "trajectory.period_s=15.0",
    "arms.left.p_object_ee_m=[-0.05, 0.0, 0.0]",
    "arms.right.p_object_ee_m=[0.05, 0.0, 0.0]",
    "object.p_start_m=[0.375, 0.0, 0.25]",
    "trajectory.p_centre_m=[0.375, 0.0, 0.25]",
    "arms.left.p_world_base_m=[0.0, 0.0, 0.0]",
    "arms.right.p_world_base_m=[0.75, 0.0, 0.0]",
    "arms.left.quat_object_ee=[1.0, 0.0, 0.0, 0.0]",
    "arms.right.quat_object_ee=[0.0, 0.0, 0.0, 1.0]",
    "arms.left.q_near_rad=[-0.4, 0.8, -0.4]",
    "arms.right.q_near_rad=[-0.4, 0.8, -0.4]",
    "safety.tau_max_fraction_of_stall=0.5",
)

# gains for it
STIFF = (
    "controller.k_p_per_s=70.0",
    "controller.k_eps_rad_per_s=140.0",
    "controller.k_p_rate_per_s=62.0",
    "controller.k_eps_rate_rad_per_s=190.0",
    *(f"arms.{arm}.k_v_N_s_per_m=3.6" for arm in ("left", "right")),
    *(f"arms.{arm}.k_v_Nm_s_per_rad=0.47" for arm in ("left", "right")),
)
