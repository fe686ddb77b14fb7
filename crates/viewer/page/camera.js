// Cameras: OpenCV axes (x right, y down, z forward), world to camera p = R m + t. R is nine numbers, row by row.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, s = 1) => a.map((value, i) => value + s * b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = a => a.map(value => value / Math.hypot(...a));
const row = (R, i) => R.slice(3 * i, 3 * i + 3);
const times = (R, v) => [0, 1, 2].map(i => dot(row(R, i), v));
// Rᵀ v.
const back = (R, v) => [0, 1, 2].map(i => R[i] * v[0] + R[3 + i] * v[1] + R[6 + i] * v[2]);

// A vector turned about an axis, radians.
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  const along = dot(axis, v) * (1 - c), across = cross(axis, v);
  return v.map((value, i) => c * value + s * across[i] + along * axis[i]);
}

// The camera whose rows are as near as may be to these, orthonormal again.
function upright(right, forward) {
  const z = unit(forward);
  const x = unit(plus(right, z, -dot(right, z)));
  return [...x, ...cross(z, x), ...z];
}

// A pose that moves: rotation and place of the camera.
class Pose {
  constructor(R, place) {
    this.R = R;
    this.place = place;
  }

  static of({ rotation, translation }) {
    return new Pose([...rotation], back(rotation, translation).map(value => -value));
  }

  get translation() {
    return times(this.R, this.place).map(value => -value);
  }

  get right() { return row(this.R, 0); }
  get forward() { return row(this.R, 2); }

  // Turns the camera in place.
  look(axis, angle) {
    this.R = upright(turned(this.right, axis, angle), turned(this.forward, axis, angle));
  }

  // Turns the camera about a point in front of it.
  orbit(axis, angle, distance) {
    const pivot = plus(this.place, this.forward, distance);
    this.look(axis, angle);
    this.place = plus(pivot, this.forward, -distance);
  }

  move(v) {
    this.place = plus(this.place, back(this.R, v));
  }
}

// A lens that shows all of what `lens` shows, and more where the window has another shape.
function fitted(lens, width, height) {
  const scale = Math.min(width / lens.width, height / lens.height);
  return {
    fx: lens.fx * scale,
    fy: lens.fy * scale,
    cx: (lens.cx - lens.width / 2) * scale + width / 2,
    cy: (lens.cy - lens.height / 2) * scale + height / 2,
    width,
    height,
  };
}

// z-depths of at most `sample` Gaussians in front of a camera, ascending.
function depths(scene, { R, translation }, sample) {
  const step = Math.max(Math.ceil(scene.n / sample), 1), columns = scene.geometry.length / Math.max(scene.n, 1);
  const found = [];
  for (let i = 0; i < scene.n; i += step) {
    const at = i * columns;
    const z = R[6] * scene.geometry[at] + R[7] * scene.geometry[at + 1] + R[8] * scene.geometry[at + 2] + translation[2];
    if (Number.isFinite(z) && z > 0) found.push(z);
  }
  return Float64Array.from(found).sort();
}

// The near plane of a camera, as gs-raster's near_plane: a share of the median depth.
function nearPlane(sorted, { share, fallback, least }, far) {
  if (sorted.length === 0) return fallback;
  return Math.min(Math.max(Math.fround(sorted[sorted.length >> 1] * share), least), far / 2);
}

const high = values => values.map(Math.fround);
const low = values => values.map(value => value - Math.fround(value));

// What the uniform says of a camera and settings; the counts of the view are added.
function frameOf({ R, translation, lens }, settings) {
  const focal = [lens.fx, lens.fy], centre = [lens.cx, lens.cy], size = [lens.width, lens.height];
  const pose = [0, 1, 2].flatMap(i => [...row(R, i), translation[i]]);
  const position = back(R, translation).map(value => -value);
  const slope = (edge, side) => edge.map((value, i) => (value - centre[i]) / focal[i] + side * settings.slope_margin * size[i] / focal[i]);
  return {
    pose: high(pose), pose_low: low(pose),
    position: high(position), position_low: low(position),
    focal: high(focal), focal_low: low(focal),
    centre: high(centre), centre_low: low(centre),
    slope_min: slope([0, 0], -1), slope_max: slope(size, 1),
    size,
    zero: 0,
    ...settings.frame,
  };
}

// The bytes of the uniform.
function frameBytes(table, values) {
  const bytes = new DataView(new ArrayBuffer(table.frame.bytes));
  for (const [name, { offset, type }] of Object.entries(table.frame.fields)) {
    if (!(name in values)) throw new Error(`the frame lacks ${name}`);
    [values[name]].flat().forEach((value, i) => {
      if (type === 'u32') bytes.setUint32(offset + 4 * i, value, true);
      else bytes.setFloat32(offset + 4 * i, value, true);
    });
  }
  return bytes.buffer;
}
