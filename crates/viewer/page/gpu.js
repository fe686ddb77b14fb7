// Carries out the views of gs-shaders' table on WebGPU. Every number, name and order comes from the table.

// A whole number that the table calculates from the counts of a view.
function amount({ of, then }, counts) {
  return then.reduce((value, step) => {
    if ('plus' in step) return value + step.plus;
    if ('times' in step) return value * step.times;
    return Math.ceil(value / step.divided_by);
  }, counts[of]);
}

// A grid of n workgroups, folded into two dimensions where it exceeds the limit of one.
function folded(n, most) {
  return n <= most ? [n, 1] : [most, Math.ceil(n / most)];
}

class Renderer {
  // A renderer, or null where the browser has no WebGPU.
  static async start(table, present) {
    const adapter = await navigator.gpu?.requestAdapter({ powerPreference: 'high-performance' });
    if (!adapter) return null;
    const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
    const timed = adapter.features.has('timestamp-query');
    const device = await adapter.requestDevice({
      requiredFeatures: timed ? ['timestamp-query'] : [],
      requiredLimits: { maxStorageBufferBindingSize, maxBufferSize },
    });
    return new Renderer(table, present, adapter, device, timed);
  }

  constructor(table, present, adapter, device, timed) {
    Object.assign(this, { table, present, adapter, device, timed });
    this.buffers = new Map();
    this.uniforms = new Map();
    this.modules = {};
    this.pipelines = [];
    this.compiling = [];
    this.plan = null;
    this.pairs = 0;
    this.n = 0;
    this.degree = 0;
  }

  // Room for `bytes` in the buffer of that name.
  room(name, bytes, usage = GPUBufferUsage.STORAGE) {
    const old = this.buffers.get(name);
    if (old && old.size >= bytes) return old;
    const limit = this.device.limits.maxStorageBufferBindingSize;
    if (bytes > limit) throw new Error(`the buffer ${name} needs ${bytes} bytes; this device allows ${limit}`);
    old?.destroy();
    const size = Math.min(4 * Math.ceil(bytes * (old ? 1.25 : 1) / 4), limit);
    const made = this.device.createBuffer({ size, usage: usage | GPUBufferUsage.COPY_SRC | GPUBufferUsage.COPY_DST });
    this.buffers.set(name, made);
    this.plan = null;
    return made;
  }

  // Chooses the views for scenes of this degree: of the `degrees` that the table has views for the next higher one.
  chooseViews(degree, degrees) {
    this.degree = degrees.find(one => one >= degree);
  }

  // Takes over the Gaussians of a scene: rows of geometry and of SH coefficients. Coefficients beyond those of the scene are 0.
  load(scene, degrees) {
    this.n = scene.n;
    this.chooseViews(scene.degree, degrees);
    const rows = { geometry: scene.geometry, sh: padded(scene, this.degree) };
    for (const [name, data] of Object.entries(rows)) {
      this.device.queue.writeBuffer(this.room(name, Math.max(data.byteLength, this.row('colour', name))), 0, data);
    }
    this.plan = null;
  }

  // A view for the degree of the scene.
  view(name) {
    return this.table.views[`${name} ${this.degree}`];
  }

  // Bytes of a row of a buffer.
  row(view, name) {
    return this.view(view).buffers.find(buffer => buffer.name === name).row;
  }

  uniform(words) {
    const key = words.join();
    if (!this.uniforms.has(key)) {
      const buffer = this.device.createBuffer({ size: 4 * words.length, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
      this.device.queue.writeBuffer(buffer, 0, new Uint32Array(words));
      this.uniforms.set(key, buffer);
    }
    return this.uniforms.get(key);
  }

  // Compiles what a view needs, all at once; what was begun before is only waited for.
  async compile(view) {
    const places = new Set(this.view(view).commands.flatMap(({ dispatch }) => dispatch ? [dispatch.pipeline] : []));
    await Promise.all([this.present.compile(this.device), ...[...places].map(place => this.compiling[place] ??= this.pipeline(place))]);
  }

  // Compiles an entry point.
  async pipeline(place) {
    const { module, entry_point, constants, bindings } = this.table.pipelines[place];
    this.modules[module] ??= this.device.createShaderModule({ label: module, code: this.table.modules[module] });
    const entries = Object.entries(bindings).map(([number, type]) => (
      { binding: Number(number), visibility: GPUShaderStage.COMPUTE, buffer: { type } }));
    const layout = this.device.createBindGroupLayout({ label: entry_point, entries });
    const pipeline = await this.device.createComputePipelineAsync({
      label: entry_point,
      layout: this.device.createPipelineLayout({ bindGroupLayouts: [layout] }),
      compute: { module: this.modules[module], entryPoint: entry_point, constants },
    });
    this.pipelines[place] = { pipeline, layout, module };
  }

  // The commands of a view with these counts, with everything bound.
  resolve(view, counts) {
    const key = JSON.stringify([view, this.degree, counts]);
    if (this.plan?.key === key) return this.plan;
    const { buffers, commands } = this.view(view);
    for (const { name, source, rows, row } of buffers) {
      const bytes = Math.max(amount(rows, counts), 1) * row;
      if (source === 'frame') this.room(name, bytes, GPUBufferUsage.UNIFORM);
      if (source === 'passes') this.room(name, bytes);
    }
    const called = new Map(buffers.map(({ name }) => [name, this.buffers.get(name)]));
    const steps = [];
    for (const { tile_bit, clear, swap, dispatch } of commands) {
      if (tile_bit !== undefined && counts.tiles >>> tile_bit === 0) continue;
      if (clear) {
        steps.push({ clear: called.get(clear) });
      } else if (swap) {
        const [a, b] = swap.map(name => called.get(name));
        called.set(swap[0], b).set(swap[1], a);
      } else {
        const groups = dispatch.groups === 'tiles'
          ? [counts.columns, counts.tiles / counts.columns]
          : folded(amount(dispatch.groups.folded, counts), this.table.grid_max);
        if (groups.includes(0)) continue;
        const { pipeline, layout, module } = this.pipelines[dispatch.pipeline];
        const entries = Object.entries(dispatch.arguments).map(([number, { buffer, words }]) => ({
          binding: Number(number),
          resource: { buffer: buffer ? called.get(buffer) : this.uniform(words.map(word => 'is' in word ? word.is : amount(word.amount, counts))) },
        }));
        steps.push({ pipeline, groups, module, group: this.device.createBindGroup({ layout, entries }) });
      }
    }
    this.plan = { key, steps };
    return this.plan;
  }

  // Records the passes of a view; with `queries` each with its times.
  record(encoder, steps, queries) {
    let pass = null;
    let place = 0;
    const end = () => { pass?.end(); pass = null; };
    for (const { clear, pipeline, groups, group } of steps) {
      if (clear) {
        end();
        encoder.clearBuffer(clear);
        continue;
      }
      pass ??= encoder.beginComputePass(queries && {
        timestampWrites: { querySet: queries, beginningOfPassWriteIndex: place++, endOfPassWriteIndex: place++ },
      });
      pass.setPipeline(pipeline);
      pass.setBindGroup(0, group);
      pass.dispatchWorkgroups(...groups);
      if (queries) end();
    }
    end();
  }

  // Draws a view of `camera` into the buffer `pixels`, and onto `canvas` if it is given. Repeats the view if there was no room
  // for all pairs of Gaussian and tile. Resolves to what the counters say, and if asked for the milliseconds of each pass and the
  // numbers of the pixels.
  async draw(view, camera, settings, { canvas, paint, measure = false, pixels = false } = {}) {
    await this.compile(view);
    const begin = performance.now();
    const { width, height } = camera.lens;
    const { tile, counters } = this.table;
    const columns = Math.ceil(width / tile);
    const tiles = columns * Math.ceil(height / tile);
    const most = Math.floor(this.device.limits.maxStorageBufferBindingSize / 4);
    this.pairs = Math.min(Math.max(this.pairs, 4 * this.n, 4096), most);
    for (;;) {
      const counts = { one: 1, gaussians: this.n, pairs: this.pairs, pixels: width * height, tiles, columns };
      const { steps } = this.resolve(view, counts);
      const frame = frameBytes(this.table, { ...frameOf(camera, settings), n_gaussians: this.n, pair_capacity: this.pairs, tiles: [columns, tiles / columns] });
      this.device.queue.writeBuffer(this.buffers.get('frame'), 0, frame);
      const encoder = this.device.createCommandEncoder();
      const timed = measure && this.timed;
      const dispatches = steps.filter(step => step.pipeline);
      const queries = timed ? this.device.createQuerySet({ type: 'timestamp', count: 2 * dispatches.length }) : null;
      this.record(encoder, steps, queries);
      const shown = canvas ? this.present.record(this, encoder, camera.lens, paint) : null;
      const count = this.staged(encoder, 'counters', 4 * counters.all);
      const picture = pixels ? this.staged(encoder, 'pixels', width * height * this.row(view, 'pixels')) : null;
      let times = null;
      if (timed) {
        const bytes = 16 * dispatches.length;
        const resolved = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.QUERY_RESOLVE | GPUBufferUsage.COPY_SRC });
        encoder.resolveQuerySet(queries, 0, 2 * dispatches.length, resolved, 0);
        times = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
        encoder.copyBufferToBuffer(resolved, 0, times, 0, bytes);
      }
      this.device.queue.submit([encoder.finish()]);
      const found = new Uint32Array(await this.read(count));
      const passes = timed ? sumByPass(dispatches, new BigUint64Array(await this.read(times))) : null;
      queries?.destroy();
      const pairs = found[counters.pairs];
      if (pairs <= this.pairs) {
        if (shown) this.present.show(canvas, camera.lens, await this.read(shown));
        const numbers = picture && new Float32Array(await this.read(picture));
        return { visible: found[counters.visible], rejected: found[counters.rejected], pairs, passes, pixels: numbers, milliseconds: performance.now() - begin };
      }
      if (pairs > most) throw new Error(`the view has ${pairs} pairs of Gaussian and tile; this device has room for ${most}`);
      this.pairs = Math.min(Math.ceil(1.25 * pairs), most);
    }
  }

  staged(encoder, name, bytes) {
    const buffer = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    encoder.copyBufferToBuffer(this.buffers.get(name), 0, buffer, 0, bytes);
    return buffer;
  }

  async read(buffer) {
    await buffer.mapAsync(GPUMapMode.READ);
    const copy = buffer.getMappedRange().slice(0);
    buffer.destroy();
    return copy;
  }
}

// Milliseconds by pass, from begin and end of every dispatch in nanoseconds.
function sumByPass(dispatches, stamps) {
  const sums = {};
  dispatches.forEach(({ module }, i) => {
    const nanoseconds = Number(stamps[2 * i + 1] - stamps[2 * i]);
    sums[module] = (sums[module] ?? 0) + Math.max(nanoseconds, 0) / 1e6;
  });
  return sums;
}

// A view's pixels as 8-bit colours. They are read back and put onto a 2D canvas: that works with every WebGPU, software included, and
// the canvas keeps its picture.
class Present {
  constructor(code) {
    this.code = code;
  }

  compile(device) {
    this.compiling ??= device.createComputePipelineAsync({
      label: 'present',
      layout: 'auto',
      compute: { module: device.createShaderModule({ label: 'present', code: this.code }), entryPoint: 'present' },
    }).then(pipeline => { this.pipeline = pipeline; });
    return this.compiling;
  }

  // Records the conversion; returns the buffer to read it from.
  record(renderer, encoder, { width, height }, { mode, near, far }) {
    const { device } = renderer;
    const n = width * height;
    this.paint ??= device.createBuffer({ label: 'paint', size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    const data = new DataView(new ArrayBuffer(16));
    [n, mode].forEach((value, i) => data.setUint32(4 * i, value, true));
    [1 / near, 1 / far].forEach((value, i) => data.setFloat32(8 + 4 * i, value, true));
    device.queue.writeBuffer(this.paint, 0, data.buffer);
    const buffers = [this.paint, renderer.buffers.get('pixels'), renderer.room('shown', 4 * n)];
    const group = device.createBindGroup({
      layout: this.pipeline.getBindGroupLayout(0),
      entries: buffers.map((buffer, binding) => ({ binding, resource: { buffer } })),
    });
    const pass = encoder.beginComputePass();
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, group);
    pass.dispatchWorkgroups(...folded(Math.ceil(n / 256), renderer.table.grid_max));
    pass.end();
    return renderer.staged(encoder, 'shown', 4 * n);
  }

  // Puts the colours onto a canvas.
  show(canvas, { width, height }, bytes) {
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    canvas.getContext('2d').putImageData(new ImageData(new Uint8ClampedArray(bytes), width, height), 0, 0);
  }
}
