// What a person does with mouse, fingers and keys, as movements of a pose.

// Radians for a drag over the whole stage.
const DRAG = Math.PI;

class Controls {
  // `state` has pose, up, distance (to what is orbited), look; `changed` is called after every movement, `key` for keys that move
  // nothing.
  constructor(stage, state, changed, key) {
    Object.assign(this, { stage, state, changed });
    this.held = new Set();
    this.pointers = new Map();
    stage.addEventListener('pointerdown', event => this.down(event));
    stage.addEventListener('pointermove', event => this.drag(event));
    for (const type of ['pointerup', 'pointercancel']) stage.addEventListener(type, event => this.up(event));
    stage.addEventListener('contextmenu', event => event.preventDefault());
    stage.addEventListener('wheel', event => {
      event.preventDefault();
      this.closer(Math.exp(Math.max(Math.min(event.deltaY, 200), -200) * 0.0015));
    }, { passive: false });
    addEventListener('keydown', event => {
      if (['SELECT', 'INPUT'].includes(event.target.tagName) && event.target.type !== 'range') return;
      if (event.ctrlKey || event.metaKey || event.altKey) return key(event);
      if (event.code in MOVES || event.code in TURNS) {
        if (event.target.tagName === 'INPUT' && event.code in TURNS) return;
        this.held.add(event.code);
        event.preventDefault();
        this.fly();
      } else {
        key(event);
      }
    });
    addEventListener('keyup', event => this.held.delete(event.code));
    addEventListener('blur', () => this.held.clear());
  }

  down(event) {
    this.stage.setPointerCapture(event.pointerId);
    this.stage.focus();
    this.stage.classList.add('dragging');
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    if (this.pointers.size === 0) this.stage.classList.remove('dragging');
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [(now[0] - before[0]) / this.stage.clientHeight, (now[1] - before[1]) / this.stage.clientHeight];
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
      const spread = place => Math.hypot(place[0] - other[0], place[1] - other[1]);
      this.pan(dx / 2, dy / 2);
      this.closer(Math.max(spread(before), 1) / Math.max(spread(now), 1));
    } else if (event.shiftKey || event.buttons & 6) {
      this.pan(dx, dy);
    } else {
      this.turn(dx, dy);
    }
    this.pointers.set(event.pointerId, now);
  }

  // To the right and down, in heights of the stage: what is dragged follows the hand.
  turn(dx, dy) {
    const { pose, up, look, distance } = this.state;
    for (const [axis, angle] of [[up, dx * DRAG], [pose.right, dy * DRAG]]) {
      if (look) pose.look(axis, angle);
      else pose.orbit(axis, -angle, distance);
    }
    this.changed();
  }

  pan(dx, dy) {
    const { pose, distance, slope } = this.state;
    pose.move([-dx * distance * slope, -dy * distance * slope, 0]);
    this.changed();
  }

  // So many times the distance to what is orbited.
  closer(factor) {
    const { state } = this;
    state.pose.move([0, 0, state.distance * (1 - factor)]);
    state.distance *= factor;
    this.changed();
  }

  fly() {
    if (this.flying) return;
    this.flying = true;
    let last = performance.now();
    const step = now => {
      const seconds = Math.min((now - last) / 1000, 0.1), { pose, up, distance } = this.state;
      last = now;
      if (this.held.size === 0) {
        this.flying = false;
        return;
      }
      for (const code of this.held) {
        if (code in MOVES) pose.move(MOVES[code].map(value => value * distance * 0.7 * seconds));
        if (code in TURNS) {
          const [about, angle] = TURNS[code];
          pose.look(about ? up : pose.right, angle * seconds);
        }
      }
      this.changed();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }
}

const MOVES = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, 1, 0], KeyE: [0, -1, 0] };
// About the vertical or not, radians a second: to the left and up are positive.
const TURNS = { ArrowLeft: [true, 1], ArrowRight: [true, -1], ArrowUp: [false, 1], ArrowDown: [false, -1] };
