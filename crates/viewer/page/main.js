// The page: state, panel, and frames that are drawn when something changed.

const $ = id => document.getElementById(id);
const data = JSON.parse($('data').textContent);

// Milliseconds of a frame above which the resolution sinks while something moves, and below which it rises.
const SLOW = 45, FAST = 18;
// Shares of the window's resolution.
const SCALES = [1, 0.75, 0.5, 0.35, 0.25];
// Milliseconds without movement after which a frame has the full resolution.
const REST = 250;
// Fewest Gaussians of the slider.
const FEWEST = 1000;

const MODES = {
  colour: { view: 'colour', mode: 0 },
  ellipsoids: { view: 'ellipsoids', mode: 0 },
  depth: { view: 'depth', mode: 1 },
  opacity: { view: 'colour', mode: 2 },
};

const state = {
  mode: 'colour', pose: null, lens: null, up: [0, -1, 0], distance: 1, slope: 1, look: false, shot: 0, at: false, level: 0, measure: false,
};
let renderer, scene, shown, controls;
let dirty = false, busy = null, moved = 0, rates = [];

function say(text) {
  $('message').textContent = text;
  $('message').hidden = !text;
}

// The lens for a stage of this size; fewer pixels while things move and frames are slow.
function lensNow(level) {
  const ratio = Math.min(devicePixelRatio || 1, 2) * SCALES[level];
  const size = [$('stage').clientWidth, $('stage').clientHeight].map(pixels => Math.max(Math.round(pixels * ratio), 1));
  return fitted(state.lens, ...size);
}

// Depths, near plane and settings for a camera.
function settingsFor(view, camera) {
  const sorted = depths(scene, camera, data.near.sample);
  const frame = data.frames[view];
  const near = data.near.fixed ?? nearPlane(sorted, data.near, data.near.far);
  const at = share => sorted[Math.floor((sorted.length - 1) * share)];
  const range = sorted.length ? [Math.max(at(0.1), near), at(0.9)] : [near, 2 * near];
  if (!(range[1] > range[0])) range[1] = 1.5 * range[0];
  return { sorted, range, settings: { frame: { ...frame, near }, slope_margin: data.slope_margin } };
}

async function drawOnce(level) {
  const { view, mode } = MODES[state.mode];
  const camera = { R: state.pose.R, translation: state.pose.translation, lens: lensNow(level) };
  const { range, settings } = settingsFor(view, camera);
  const result = await renderer.draw(view, camera, settings, {
    canvas: $('canvas'), paint: { mode, near: range[0], far: range[1] }, measure: state.measure,
  });
  return { ...result, lens: camera.lens };
}

// Something changed: draws a frame soon, and again at rest.
function changed() {
  moved = performance.now();
  state.at = false;
  placePhotograph();
  request();
}

function request() {
  dirty = true;
  busy ??= new Promise(resolve => requestAnimationFrame(resolve)).then(frames).catch(error => say(String(error.message ?? error))).finally(() => {
    busy = null;
    if (dirty) request();
  });
}

async function frames() {
  while (dirty) {
    dirty = false;
    const moving = performance.now() - moved < REST;
    const level = moving ? state.level : 0;
    const frame = await drawOnce(level);
    viewer.frames += 1;
    viewer.shownAfter ??= performance.now();
    if (moving) {
      rates = [...rates.slice(-7), frame.milliseconds];
      if (frame.milliseconds > SLOW) state.level = Math.min(state.level + 1, SCALES.length - 1);
      else if (frame.milliseconds < FAST) state.level = Math.max(state.level - 1, 0);
    }
    tell(frame, moving);
    await new Promise(resolve => requestAnimationFrame(resolve));
    if (level > 0 && !dirty) {
      while (!dirty && performance.now() - moved < REST) await new Promise(resolve => requestAnimationFrame(resolve));
      dirty = true;
    }
  }
}

const grouped = n => n.toLocaleString('en');

function tell({ milliseconds, visible, rejected, lens, passes }, moving) {
  const mean = rates.reduce((sum, one) => sum + one, 0) / Math.max(rates.length, 1);
  const rate = moving && rates.length ? `, ${(1000 / mean).toFixed(mean > 100 ? 1 : 0)} fps` : '';
  const left = rejected ? `\n${grouped(rejected)} cannot be drawn` : '';
  $('status').textContent = `${grouped(shown.n)} Gaussians, ${grouped(visible)} in view\n${lens.width} × ${lens.height}, ${milliseconds.toFixed(0)} ms${rate}${left}`;
  if (!state.measure) return;
  if (!renderer.timed) {
    $('passes').textContent = 'This device has no timestamps.';
    return;
  }
  // A frame that began before times were asked for has none; the next one follows.
  const rows = passes ? [...Object.entries(passes), ['all passes', Object.values(passes).reduce((sum, one) => sum + one, 0)]] : [];
  $('passes').replaceChildren(...rows.map(([name, time]) => {
    const line = document.createElement('tr');
    for (const text of [name, `${time.toFixed(2)} ms`]) line.append(Object.assign(document.createElement('td'), { textContent: text }));
    return line;
  }));
}

// The photograph of the camera lies over its frame, left of the slider.
function placePhotograph() {
  const shot = data.shots[state.shot];
  const has = Boolean(state.at && shot?.photograph);
  $('compare-row').hidden = !has;
  const share = Number($('compare').value);
  for (const id of ['photograph', 'divider']) $(id).hidden = !has || share === 0;
  if (!has) return;
  const { clientWidth: width, clientHeight: height } = $('stage');
  const scale = Math.min(width / state.lens.width, height / state.lens.height);
  const box = { width: state.lens.width * scale, height: state.lens.height * scale };
  const left = (width - box.width) / 2, top = (height - box.height) / 2;
  const picture = $('photograph');
  if (picture.dataset.of !== String(state.shot)) {
    picture.src = shot.photograph;
    picture.dataset.of = state.shot;
  }
  Object.assign(picture.style, { left: `${left}px`, top: `${top}px`, width: `${box.width}px`, height: `${box.height}px`, clipPath: `inset(0 ${100 * (1 - share)}% 0 0)` });
  Object.assign($('divider').style, { left: `${left + share * box.width}px`, top: `${top}px`, height: `${box.height}px` });
}

// Goes to a camera of the list.
function jump(place) {
  const shot = data.shots[place];
  state.shot = place;
  state.pose = Pose.of(shot.camera);
  state.lens = { ...shot.camera.intrinsics };
  state.slope = state.lens.height / state.lens.fy;
  const sorted = depths(scene, { R: state.pose.R, translation: state.pose.translation }, data.near.sample);
  state.distance = sorted.length ? sorted[sorted.length >> 1] : 1;
  $('cameras').value = place;
  moved = performance.now();
  state.at = true;
  placePhotograph();
  request();
}

function setMode(mode) {
  state.mode = mode;
  for (const button of document.querySelectorAll('#modes button')) button.setAttribute('aria-pressed', button.dataset.mode === mode);
  request();
}

// The slider's position to a number of Gaussians, in equal ratios.
function amountOf(position) {
  const fewest = Math.min(FEWEST, scene.n);
  return position >= 1 ? scene.n : Math.round(fewest * (scene.n / fewest) ** position);
}

function setAmount() {
  const count = scene.n ? amountOf(Number($('amount').value)) : 0;
  $('amount-text').textContent = `${grouped(count)} of ${grouped(scene.n)}`;
  shown = thinned(scene, count, data.scene.log_scale);
  renderer.load(shown, data.degrees);
  request();
}

function setScene(next) {
  scene = next;
  $('amount').value = 1;
  $('amount-row').hidden = scene.n <= FEWEST;
  setAmount();
}

async function openFile(file) {
  try {
    const next = readPly(await file.arrayBuffer(), data.scene.geometry_columns);
    await busy;
    setScene(next);
    document.querySelector('#panel h1').textContent = file.name;
    say('');
    // Photographs and cameras are those of the page's own scene.
    data.shots = [overview(scene)];
    listCameras();
    jump(0);
  } catch (error) {
    const advice = 'This page reads PLY files of 3D Gaussian splatting; "sparsesplat convert" makes one of other formats.';
    say(`${file.name}: ${error.message ?? error}. ${advice}`);
  }
}

// A camera before a scene that comes without one: outside, level, with y down.
function overview({ n, geometry }) {
  const columns = geometry.length / Math.max(n, 1), step = Math.max(Math.ceil(n / 4096), 1);
  const middle = [0, 1, 2].map(axis => {
    const values = [];
    for (let i = 0; i < n; i += step) values.push(geometry[i * columns + axis]);
    const sorted = Float64Array.from(values.filter(Number.isFinite)).sort();
    const at = share => sorted[Math.floor((sorted.length - 1) * share)] ?? 0;
    return { centre: at(0.5), reach: at(0.9) - at(0.1) };
  });
  const reach = Math.max(...middle.map(one => one.reach)) || 1;
  const translation = middle.map(({ centre }) => -centre);
  translation[2] += 1.6 * reach;
  const intrinsics = { fx: 800, fy: 800, cx: 480, cy: 360, width: 960, height: 720 };
  return { name: 'overview', camera: { rotation: [1, 0, 0, 0, 1, 0, 0, 0, 1], translation, intrinsics } };
}

function listCameras() {
  $('cameras').replaceChildren(...data.shots.map(({ name, photograph }, i) => (
    Object.assign(document.createElement('option'), { value: i, textContent: photograph ? `${name} \u25e7` : name }))));
  // Up is where the cameras have it on average.
  const ups = data.shots.map(({ camera }) => row(camera.rotation, 1).map(value => -value));
  const mean = ups.reduce((sum, one) => plus(sum, one), [0, 0, 0]);
  state.up = Math.hypot(...mean) > 0.1 * ups.length ? unit(mean) : ups[0];
}

async function save() {
  await busy;
  await drawOnce(0);
  const blob = await new Promise(resolve => $('canvas').toBlob(resolve, 'image/png'));
  const link = Object.assign(document.createElement('a'), { href: URL.createObjectURL(blob), download: `${data.title}.png` });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function onKey(event) {
  const cycle = step => jump((state.shot + step + data.shots.length) % data.shots.length);
  const modes = { Digit1: 'colour', Digit2: 'ellipsoids', Digit3: 'depth', Digit4: 'opacity' };
  const actions = {
    KeyN: () => cycle(1), KeyP: () => cycle(-1), KeyR: () => jump(state.shot), KeyF: () => $('fly').click(),
    KeyH: () => $('fold').click(), KeyT: () => $('measure').click(),
  };
  if (event.ctrlKey && event.code === 'KeyS') { event.preventDefault(); save(); }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code in modes) setMode(modes[event.code]);
  else actions[event.code]?.();
}

function wire() {
  controls = new Controls($('stage'), state, changed, onKey);
  for (const button of document.querySelectorAll('#modes button')) button.addEventListener('click', () => setMode(button.dataset.mode));
  const pressed = (button, value) => button.setAttribute('aria-pressed', value);
  $('amount').addEventListener('input', setAmount);
  $('compare').addEventListener('input', placePhotograph);
  $('cameras').addEventListener('change', () => jump(Number($('cameras').value)));
  $('before').addEventListener('click', () => onKey({ code: 'KeyP' }));
  $('next').addEventListener('click', () => onKey({ code: 'KeyN' }));
  $('reset').addEventListener('click', () => jump(state.shot));
  $('save').addEventListener('click', save);
  $('open').addEventListener('click', () => $('file').click());
  $('file').addEventListener('change', () => { if ($('file').files[0]) openFile($('file').files[0]); });
  $('fly').addEventListener('click', () => { state.look = !state.look; pressed($('fly'), state.look); });
  $('fold').addEventListener('click', () => { $('controls').hidden = !$('controls').hidden; });
  $('measure').addEventListener('click', () => {
    state.measure = !state.measure;
    pressed($('measure'), state.measure);
    $('passes').hidden = !state.measure;
    request();
  });
  addEventListener('resize', () => { placePhotograph(); request(); });
  addEventListener('dragover', event => { event.preventDefault(); $('stage').classList.add('target'); });
  addEventListener('dragleave', () => $('stage').classList.remove('target'));
  addEventListener('drop', event => {
    event.preventDefault();
    $('stage').classList.remove('target');
    const [file] = event.dataTransfer.files;
    if (file) openFile(file);
  });
}

// Pictures instead of the scene, and why.
function fallBack(why) {
  for (const id of ['stage', 'panel']) $(id).hidden = true;
  $('fallback').hidden = false;
  $('why').textContent = why;
  document.documentElement.style.overflow = 'auto';
}

// For tests and for the console: numbers of a frame that was drawn into the buffer, not onto the canvas.
const viewer = {
  frames: 0,
  shownAfter: null,
  state,
  get scene() { return shown; },
  get busy() { return busy; },
  async frame(view, { rotation, translation, intrinsics }, measure = false) {
    await busy;
    const camera = { R: rotation, translation, lens: intrinsics };
    const { settings } = settingsFor(view, camera);
    return renderer.draw(view, camera, settings, { measure, pixels: true });
  },
  save,
};
globalThis.viewer = viewer;

async function start() {
  renderer = await Renderer.start(data.table, new Present(data.present));
  if (!renderer) return fallBack('This browser has no WebGPU, or no device for it.');
  renderer.device.lost.then(({ reason, message }) => { if (reason !== 'destroyed') fallBack(`The graphics device was lost: ${message}`); });
  renderer.device.addEventListener('uncapturederror', ({ error }) => say(error.message));
  // Pipelines are compiled in another process while the scene is unpacked here. What goes wrong is told by the first frame.
  renderer.chooseViews(data.scene.degree, data.degrees);
  renderer.compile('colour').catch(() => {});
  setScene(unpacked(data.scene, await packedBytes($('scene'))));
  if (data.shots.length === 0) data.shots = [overview(scene)];
  listCameras();
  wire();
  // On a small screen the panel would cover the scene.
  $('controls').hidden = matchMedia('(max-width: 560px)').matches;
  jump(data.start);
}

start().catch(error => fallBack(String(error.message ?? error)));
