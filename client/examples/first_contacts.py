"""A first look: two boxes, then a small pile, step by step.

    python client/examples/first_contacts.py

Needs the hullcast binary (HULLCAST_BIN, or on PATH). The `# %%` lines are cells
for editors that show them, so that it can be stepped through like a notebook.
"""

# %% A server of one's own; `hullcast.connect("host:port")` for another's.
import numpy as np

import hullcast

client = hullcast.serve()

# %% Register shapes once, as points. What comes back says what they are.
signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
table, cube = client.register([signs * [1.0, 0.6, 0.05], signs * 0.1])
print(f"{cube.vertex_count} vertices, {cube.face_count} faces, volume {cube.volume:.3g} m^3")

# %% A scene: which hull each body is, and where. Lengths in metres, quaternions x, y, z, w.
half_turn = np.deg2rad(30) / 2
scene = hullcast.Scene(
    [table, cube, cube],
    positions=[[0, 0, 0], [0.2, 0.1, 0.149], [0.45, 0.1, 0.152]],
    rotations=[[0, 0, 0, 1], [0, 0, np.sin(half_turn), np.cos(half_turn)], [0, 0, 0, 1]],
)

# %% Ask about pairs of bodies. The margin is the distance within which points are wanted.
m = client.query(scene, pairs=[[0, 1], [0, 2], [1, 2]], margin=0.005)
print(m)

# %% One pair at a time ...
first = m[0]
print(f"growth scale {first.alpha:.6f}, for certain in [{first.alpha_lower}, {first.alpha_upper}]")
print(f"normal {first.normal}, from body {first.bodies[0]} to {first.bodies[1]}")
for point, distance in zip(first.witness_a, first.distance, strict=True):
    print(f"  on the table at {point.round(4)}, {-distance * 1000:.2f} mm deep")

# %% ... or all at once, as columns: the points of pair i are offsets[i] to offsets[i + 1].
touching = m.outcome == hullcast.Outcome.CONTACT
print(f"pairs in contact: {m.pairs[touching].tolist()}")
print(f"points a pair: {np.diff(m.point_offsets).tolist()}")
print(f"deepest: {m.distance.min():.4f} m")

# %% Step: the same bodies at new poses, starting from the last answer's bases.
outputs = ["NORMAL", "POINTS", "BASES"]
m = client.query(scene, m.pairs, margin=0.005, outputs=outputs)
fall = np.array([[0, 0, 0], [0, 0, -0.0005], [0, 0, -0.0005]])
for step in range(1, 4):
    scene = scene.moved(scene.positions + fall, scene.rotations)
    m = client.query(scene, m.pairs, margin=0.005, outputs=outputs, warm=m)
    print(f"step {step}: deepest {m.distance.min():.4f} m over {len(m.distance)} points")

# %% Speed against accuracy: a looser bracket, fewer points.
quick = hullcast.Accuracy(relative_tolerance=1e-3, max_points=4)
m = client.query(scene, [[0, 1]], margin=0.005, accuracy=quick)
print(f"bracket {m.alpha_upper[0] - m.alpha_lower[0]:.1e} wide, {len(m.distance)} points")

# %% What is wrong is said plainly.
try:
    client.register([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]])
except hullcast.HullRejected as error:
    print(f"refused: {error}")

# %% The server ends with its client.
client.close()
