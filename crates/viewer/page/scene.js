// Scenes: the packed one of the page, and PLY files that are dropped. A scene is { n, degree, geometry, sh }: rows of f32.

const coefficients = degree => (degree + 1) ** 2;

// The number of 16 bits of IEEE 754.
function half(bits) {
  const sign = bits >> 15 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

// The scene in `bytes`, whose blocks the header describes.
function unpacked({ n, degree, geometry_columns, blocks }, bytes) {
  const data = new DataView(bytes);
  const rows = { geometry: geometry_columns, sh: 3 * coefficients(degree) };
  const scene = { n, degree };
  for (const name of ['geometry', 'sh']) scene[name] = new Float32Array(n * rows[name]);
  let at = 0;
  for (const { into, from, columns, type } of blocks) {
    const target = scene[into], width = rows[into];
    for (let i = 0; i < n; i++) {
      let step = 1;
      if (type === 'scaled_i8') {
        step = half(data.getUint16(at, true));
        at += 2;
      }
      for (let column = from; column < from + columns; column++) {
        let value;
        if (type === 'f32') { value = data.getFloat32(at, true); at += 4; }
        else if (type === 'f16') { value = half(data.getUint16(at, true)); at += 2; }
        else { value = data.getInt8(at) * step; at += 1; }
        target[i * width + column] = value;
      }
    }
  }
  if (at !== bytes.byteLength) throw new Error(`the scene of the page has ${bytes.byteLength} bytes, expected ${at}`);
  return scene;
}

// SH rows of a higher degree, the coefficients beyond those of the scene 0.
function padded({ n, degree, sh }, to) {
  if (degree === to) return sh;
  const [old, wide] = [3 * coefficients(degree), 3 * coefficients(to)], rows = new Float32Array(n * wide);
  for (let i = 0; i < n; i++) rows.set(sh.subarray(i * old, (i + 1) * old), i * wide);
  return rows;
}

async function packedBytes(element) {
  if (element.dataset.source) {
    const answer = await fetch(element.dataset.source);
    if (!answer.ok) throw new Error(`${element.dataset.source}: ${answer.status} ${answer.statusText}`);
    return answer.arrayBuffer();
  }
  const text = atob(element.textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes.buffer;
}

const SCALARS = {
  char: [1, 'getInt8'], int8: [1, 'getInt8'], uchar: [1, 'getUint8'], uint8: [1, 'getUint8'],
  short: [2, 'getInt16'], int16: [2, 'getInt16'], ushort: [2, 'getUint16'], uint16: [2, 'getUint16'],
  int: [4, 'getInt32'], int32: [4, 'getInt32'], uint: [4, 'getUint32'], uint32: [4, 'getUint32'],
  float: [4, 'getFloat32'], float32: [4, 'getFloat32'], double: [8, 'getFloat64'], float64: [8, 'getFloat64'],
};

// A scene in the layout of 3D Gaussian splatting, binary little endian. Throws an error that names the rule.
function readPly(bytes, geometryColumns) {
  const text = new TextDecoder('latin1').decode(bytes.slice(0, 65536));
  if (!/^ply\r?\n/.test(text)) throw new Error('not a PLY file (the first line is not "ply")');
  const end = /^end_header\r?\n/m.exec(text);
  if (!end) throw new Error('the header has no end_header within 64 KiB');
  const lines = text.slice(0, end.index).split(/\r?\n/).map(line => line.trim().split(/\s+/));
  const format = lines.find(([word]) => word === 'format');
  if (format?.[1] !== 'binary_little_endian') throw new Error(`format ${JSON.stringify(format?.[1] ?? '')} is not supported here, expected binary_little_endian`);
  const elements = lines.filter(([word]) => word === 'element');
  if (elements[0]?.[1] !== 'vertex') throw new Error('the first element must be "vertex"');
  const n = Number(elements[0][2]);
  if (!Number.isSafeInteger(n) || n < 0) throw new Error(`${elements[0][2]} is no number of vertices`);
  const first = lines.indexOf(elements[0]), last = elements[1] ? lines.indexOf(elements[1]) : lines.length;
  const columns = new Map();
  let stride = 0;
  for (const [word, type, name] of lines.slice(first + 1, last)) {
    if (word !== 'property') continue;
    const scalar = SCALARS[type];
    if (!scalar) throw new Error(`property ${name}: the type ${type} is not supported`);
    columns.set(name, { at: stride, read: scalar[1] });
    stride += scalar[0];
  }
  const rest = [...columns.keys()].filter(name => name.startsWith('f_rest_')).length;
  const degree = [0, 1, 2, 3].find(d => 3 * (coefficients(d) - 1) === rest);
  if (degree === undefined) throw new Error(`${rest} f_rest properties are no SH degree from 0 to 3`);
  const perChannel = coefficients(degree) - 1;
  const numbered = (prefix, count) => [...Array(count).keys()].map(i => prefix + i);
  const names = {
    geometry: ['x', 'y', 'z', ...numbered('rot_', 4), ...numbered('scale_', 3), 'opacity'],
    // f_rest is channel by channel in the file, rows of SH are coefficient by coefficient.
    sh: [...numbered('f_dc_', 3), ...numbered('', 3 * perChannel).map((_, i) => `f_rest_${(i % 3) * perChannel + Math.floor(i / 3)}`)],
  };
  if (names.geometry.length !== geometryColumns) throw new Error('this page expects another layout of Gaussians');
  for (const name of [...names.geometry, ...names.sh]) {
    if (!columns.has(name)) throw new Error(`vertex property "${name}" is missing`);
  }
  const start = end.index + end[0].length, found = Math.floor((bytes.byteLength - start) / Math.max(stride, 1));
  if (found < n) throw new Error(`truncated: the header promises ${n} vertices, the file has ${found}`);
  const data = new DataView(bytes, start);
  const scene = { n, degree };
  for (const [into, list] of Object.entries(names)) {
    const target = new Float32Array(n * list.length);
    list.forEach((name, column) => {
      const { at, read } = columns.get(name);
      for (let i = 0; i < n; i++) target[i * list.length + column] = data[read](i * stride + at, true);
    });
    scene[into] = target;
  }
  return scene;
}

// The Gaussian's place in a progressive order: the Gaussians along a Morton curve, visited in the order of reversed bits, so that
// every prefix is spread over the scene as the whole is. Files are ordered by view; their prefixes are not.
function progressiveRanks({ n, geometry }) {
  const columns = geometry.length / Math.max(n, 1);
  const bounds = [0, 1, 2].map(axis => {
    const values = Float32Array.from({ length: Math.min(n, 4096) }, (_, i) => geometry[Math.floor(i * n / Math.min(n, 4096)) * columns + axis]).filter(Number.isFinite).sort();
    return [values[Math.floor(values.length * 0.02)] ?? 0, values[Math.floor(values.length * 0.98)] ?? 1];
  });
  const spread = v => { let key = 0; for (let bit = 0; bit < 10; bit++) key |= ((v >> bit) & 1) << (3 * bit); return key; };
  const keys = new Uint32Array(n);
  for (let i = 0; i < n; i++) {
    for (let axis = 0; axis < 3; axis++) {
      const [from, to] = bounds[axis];
      const cell = Math.floor(1023 * (geometry[i * columns + axis] - from) / (to - from || 1));
      keys[i] |= spread(Math.min(Math.max(cell || 0, 0), 1023)) << axis;
    }
  }
  const sorted = Uint32Array.from(keys.keys()).sort((a, b) => keys[a] - keys[b] || a - b);
  const bits = Math.max(Math.ceil(Math.log2(Math.max(n, 1))), 0), ranks = new Uint32Array(n);
  let rank = 0;
  for (let i = 0; i < 2 ** bits; i++) {
    let reversed = 0;
    for (let bit = 0; bit < bits; bit++) if (i >> bit & 1) reversed |= 1 << (bits - 1 - bit);
    if (reversed < n) ranks[sorted[reversed]] = rank++;
  }
  return ranks;
}

// The first `count` Gaussians of the progressive order, in the order of the file. Each covers the area of those that are left
// out beside it: its scales grow by the square root of the ratio, as they do when fewer pixels are chosen.
function thinned(scene, count, logScale) {
  if (count >= scene.n) return scene;
  scene.ranks ??= progressiveRanks(scene);
  const wide = scene.geometry.length / scene.n, sh = scene.sh.length / scene.n, grow = 0.5 * Math.log(scene.n / count);
  const part = { n: count, degree: scene.degree, geometry: new Float32Array(count * wide), sh: new Float32Array(count * sh) };
  let to = 0;
  for (let i = 0; i < scene.n; i++) {
    if (scene.ranks[i] >= count) continue;
    part.geometry.set(scene.geometry.subarray(i * wide, (i + 1) * wide), to * wide);
    part.sh.set(scene.sh.subarray(i * sh, (i + 1) * sh), to * sh);
    for (let axis = 0; axis < 3; axis++) part.geometry[to * wide + logScale + axis] += grow;
    to++;
  }
  return part;
}
