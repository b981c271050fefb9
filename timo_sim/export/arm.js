// Runs and draws the scenes of a page that timo_sim export-web wrote.
'use strict';

const WINDOW = 10;       // of the curves [s]
const TRAIL = 3;         // [s]
const RATE = 100;        // samples of curves per second, at most
const BUDGET = 12;       // of a frame for steps [ms]
const SCALES = [1, 2, 5, 10, 20, 50];  // of the drawn deflection
const POINTS = 41;       // of a shape
const REACH = 80;        // from the tip to where dragging it may begin [px]

const byId = id => document.getElementById(id);
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), each => each.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// An instance of a scene; its functions are those of the C library, doc/export.md.
class Arm {
  constructor(scene, exports, tables) {
    this.scene = scene;
    this.code = exports;
    this.tables = tables;
    this.station = 0;
    this.loaded = true;
    this.instance = (exports.__heap_base.value + 63) & ~63;
    this.room = (this.instance + scene.size + 63) & ~63;
    const end = this.room + Math.max(
      8 * 2 * POINTS, 8 * scene.outputs.length, ...scene.blocks.map(([, , length]) => 4 * length));
    const missing = end - exports.memory.buffer.byteLength;
    if (missing > 0) exports.memory.grow(Math.ceil(missing / 65536));
    this.bytes = new Uint8Array(exports.memory.buffer);
    this.inputs = Object.fromEntries(scene.inputs.map(([name], number) => [name, number]));
    this.places = Object.fromEntries(scene.outputs.map((name, number) => [name, number]));
    this.blocks = scene.blocks.map(([symbol, offset, length, rows, step, ...loads]) => {
      const place = exports[symbol].value + offset;
      return { place, rows, step, loads, own: this.bytes.slice(place, place + length) };
    });
    exports.arm_create(this.instance, scene.size);
  }

  numbers(count) {
    return new Float64Array(this.code.memory.buffer, this.room, count);
  }

  reset() { this.code.arm_reset(this.instance); }

  step(count) { return this.code.arm_step(this.instance, BigInt(count)) === 0; }

  // Set an input of the scene's run and of the finer one that measures its error, or of that alone.
  set(name, value, finer = false) {
    const set = finer ? this.code.arm_set_finer_input : this.code.arm_set_input;
    if (name in this.inputs) set(this.instance, this.inputs[name], value);
  }

  // What a controller sees: [carrier x, y, shaft, its speed, tip x, y], and those of the finer run.
  seen() {
    const names = ['carrier_x', 'carrier_y', 'shaft', 'shaft_velocity', 'tip_x', 'tip_y'];
    const found = [names.map(name => this.get(name))];
    if (this.code.arm_get_finer) {
      this.code.arm_get_finer(this.instance, this.room);
      const [x, y, shaft, , , speed, tipX, tipY] = this.numbers(9);
      found.push([x, y, shaft, speed, tipX, tipY]);
    }
    return found;
  }

  get(name) {
    this.code.arm_get_output(this.instance, this.places[name], this.room);
    return this.numbers(1)[0];
  }

  outputs() {
    this.code.arm_get_outputs(this.instance, this.room);
    const values = this.numbers(this.scene.outputs.length);
    return Object.fromEntries(this.scene.outputs.map((name, number) => [name, values[number]]));
  }

  shape() {
    this.code.arm_get_shape(this.instance, this.room);
    return this.numbers(2 * POINTS).slice();
  }

  limit(number, value) {
    return this.code.arm_set_parameter(this.instance, number, value) === 0;
  }

  limitOf(number) {
    this.code.arm_get_parameter(this.instance, number, this.room);
    return this.numbers(1)[0];
  }

  // Put the constants of another arm in place: exclusive-or with those of the scene. Propagators
  // are made of their linear parts, of so many rows.
  choose(station) {
    let from = (station - 1) * this.tables.length / (this.scene.loops.length - 1);
    for (const { place, own, rows, step } of this.blocks) {
      this.bytes.set(own, place);
      if (!station) continue;
      const table = this.tables.subarray(from, from += 8 * rows ** 2 || own.length);
      if (rows) this.bytes.set(this.propagator(table, rows, step, own.length), place);
      else table.forEach((value, k) => { this.bytes[place + k] ^= value; });
    }
    this.station = station;
    this.useLoads(this.loaded);
  }

  // See etdrk4.propagate, which needs half as much room again as a propagator, of zeros.
  propagator(linear, rows, step, length) {
    const scale = this.room + 1.5 * length, series = scale + 8 * rows;
    const begin = series + 8 * this.scene.series.length;
    this.bytes.fill(0, this.room, scale);
    new Float64Array(this.bytes.buffer, series).set(this.scene.series);
    this.bytes.set(linear, begin);
    this.code.propagate(begin, BigInt(rows), step, series, scale, this.room);
    return this.bytes.subarray(this.room, this.room + length);
  }

  // Take the loads of the scene away, or give them back; no table changes them.
  useLoads(used) {
    this.loaded = used;
    for (const { place, own, loads: [from, to] } of this.blocks) {
      if (used) this.bytes.set(own.subarray(from, to), place + from);
      else this.bytes.fill(0, place + from, place + to);
    }
  }
}

async function load(scene) {
  const [wasm, tables] = await Promise.all([inflate(scene.wasm), inflate(scene.tables)]);
  const { instance } = await WebAssembly.instantiate(wasm, {});
  return new Arm(scene, instance.exports, tables);
}

// The controller: torque = kp (goal - angle) - kd speed, the goal a step that may be shaped.
class Loop {
  constructor() {
    this.closed = false;
    this.goal = { time: 0, from: 0, to: 0, times: [0], amplitudes: [1] };
  }

  goalAt(time) {
    const { from, to, times, amplitudes } = this.goal;
    let part = 0;
    for (let k = 0; k < times.length; ++k)
      if (time >= this.goal.time + times[k] - 1e-9) part += amplitudes[k];
    return from + (to - from) * part;
  }

  begin(time, to, law, shaped) {
    this.goal = { time, from: this.goalAt(time), to, times: shaped ? law.times : [0],
                  amplitudes: shaped ? law.amplitudes : [1] };
  }

  hold(time, angle) { this.goal = { time, from: angle, to: angle, times: [0], amplitudes: [1] }; }
}

const scenes = JSON.parse(byId('scenes').textContent);
let arm, scene, law, values;  // what is shown; `values` are its outputs now
const loop = new Loop();
const manual = {};            // inputs by sliders
const held = new Set();       // keys
let running = true, behind = 0, diverged = false, pointer = null, owed = 0, last = 0;
let samples = [], unsampled = 0, trail = [], view = null;

// Numbers as people write them.
const figure = value => {
  if (!Number.isFinite(value)) return value > 0 ? 'none' : '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  const text = size >= 1e5 || size < 1e-3 ? value.toExponential(1) :
    String(Number(value.toPrecision(3)));
  return text.replaceAll('-', '−');
};

function slider(parent, label, unit, range, changed) {
  const row = document.createElement('label');
  row.className = 'row';
  row.innerHTML = '<span></span><input type="range"><output></output>';
  const [name, input, output] = row.children;
  name.textContent = label;
  if (unit) name.insertAdjacentHTML('beforeend', ` <small>${unit}</small>`);
  Object.assign(input, range);
  const show = () => { output.textContent = changed(Number(input.value)); };
  input.addEventListener('input', show);
  input.addEventListener('dblclick', () => { input.value = range.value; show(); });
  parent.append(row);
  show();
  return input;
}

const TITLES = { torque: 'torque', voltage: 'voltage', force_x: 'carrier force x',
                 force_y: 'carrier force y', tip_force_across_arm: 'force across tip' };

function build() {
  byId('about').textContent = scene.about;
  const inputs = byId('inputs');
  inputs.replaceChildren();
  for (const [name, unit] of scene.inputs) {
    const most = scene.ranges[name];
    manual[name] = 0;
    if (!most) continue;
    const made = slider(inputs, TITLES[name], unit, { min: -50, max: 50, step: 1, value: 0 },
                        value => figure(manual[name] = value / 50 * most));
    made.id = name;
  }
  byId('keys-of-carrier').hidden = !(scene.ranges.force_x || scene.ranges.force_y);
  byId('of-scene').innerHTML = scene.loads ? '<label class="check">' +
    '<input type="checkbox" id="loads" checked>the loads of the scene act, too</label>' : '';
  if (scene.loads)
    byId('loads').addEventListener('change', event => arm.useLoads(event.target.checked));
  const stations = byId('stations');
  stations.replaceChildren();
  const made = [];
  let ready = false;
  for (const each of scene.sliders) {
    const own = each.stations.findIndex(([, number]) => number === 0);
    const input = slider(
      stations, each.label, each.unit,
      { min: 0, max: each.stations.length - 1, step: 1, value: own }, value => {
        const [shown, number] = each.stations[value];
        if (ready && (number || made.every(other => other.input.value == other.own))) {
          for (const other of made)
            if (other.input !== input && other.input.value != other.own) {
              other.input.value = other.own;
              other.input.nextElementSibling.textContent = figure(other.shown);
            }
          choose(number, each.label);
        }
        return figure(shown);
      });
    input.dataset.kind = each.label;
    made.push({ input, own, shown: each.stations[own][0] });
  }
  ready = true;
  byId('stations-note').textContent = made.length > 1 ?
    'Only one of them can differ from the scene. Another mass starts the run anew.' : '';
  const limits = byId('limits');
  limits.replaceChildren();
  scene.parameters.forEach(([name, unit, meaning], number) => {
    const row = document.createElement('label');
    row.className = 'row';
    row.title = meaning;
    row.innerHTML = '<span></span><input type="number" min="0" step="any" placeholder="none">';
    row.children[0].textContent = name.replace(/^(motor|carrier)_(dc_)?/, '').replace('_limit', '')
      .replaceAll('_', ' ');
    row.children[0].insertAdjacentHTML('beforeend', ` <small>${unit}</small>`);
    const input = row.children[1], now = arm.limitOf(number);
    input.value = Number.isFinite(now) ? now : '';
    input.addEventListener('change', () => {
      if (!arm.limit(number, input.value === '' ? Infinity : Number(input.value)))
        input.value = '';
    });
    limits.append(row);
  });
  choose(0, '');
}

function choose(station, kind) {
  arm.choose(station);
  law = scene.loops[station];
  byId('loop').style.display = law.why ? 'none' : '';
  byId('gains').textContent = law.why ? `There is none: ${law.why}.` :
    `kp ${figure(law.gains[0])} N m/rad, kd ${figure(law.gains[1])} N m s/rad; its slowest ` +
    `vibration has ${figure(law.frequency)} Hz and a damping ratio of ${figure(law.damping)}.`;
  if (kind.startsWith('mass') || arm.massChanged) reset();
  arm.massChanged = kind.startsWith('mass') && station > 0;
}

function reset() {
  arm.reset();
  samples = [];
  trail = [];
  diverged = false;
  owed = 0;
  loop.hold(0, arm.get('shaft'));
  sample();
}

function sample() {
  values = arm.outputs();
  unsampled = 0;
  samples.push({ time: values.time, deflection: values.tip_transverse, strain: values.root_strain,
                 shaft: values.shaft, torque: values.shaft_torque,
                 goal: loop.closed ? loop.goalAt(values.time) : NaN });
  while (samples[0].time < values.time - WINDOW) samples.shift();
}

// Set the inputs of the next step. The finer run has a controller and a spring of its own.
function command() {
  const key = (plus, minus) => held.has(plus) - held.has(minus);
  const { ranges } = scene, closed = loop.closed && !law.why;
  const pushed = { torque: key('ArrowLeft', 'ArrowRight'), force_x: key('d', 'a'),
                   force_y: key('w', 's') };
  if ('voltage' in ranges) [pushed.voltage, pushed.torque] = [pushed.torque, 0];
  const given = name => manual[name] + 0.6 * (pushed[name] || 0) * (ranges[name] || 0);
  for (const name of ['torque', 'voltage', 'force_x', 'force_y', 'tip_force_across_arm'])
    arm.set(name, given(name));
  arm.pull = [0, 0];
  for (const name of ['tip_force_x', 'tip_force_y']) arm.set(name, 0);
  if (!closed && !pointer) return;
  const goal = loop.given = loop.goalAt(arm.get('time'));
  arm.seen().forEach(([x, y, shaft, speed, tipX, tipY], run) => {
    if (closed)
      arm.set('torque', given('torque') + law.gains[0] * (goal - shaft) - law.gains[1] * speed, run);
    if (!pointer) return;
    // A spring, with a damper against the carrier, which the picture follows; at most as strong as
    // what bends a clamped arm by a tenth.
    const most = 0.1 * scene.body.length * ranges.spring, damper = ranges.damper / scene.step;
    const now = [tipX - x, tipY - y], before = pointer.before[run] || now;
    const pull = [ranges.spring * (pointer.x - tipX) - damper * (now[0] - before[0]),
                  ranges.spring * (pointer.y - tipY) - damper * (now[1] - before[1])];
    const share = Math.min(1, most / Math.hypot(...pull));
    pull.forEach((value, axis) => arm.set(['tip_force_x', 'tip_force_y'][axis], share * value, run));
    pointer.before[run] = now;
    if (!run) arm.pull = pull.map(value => share * value);
  });
}

function advance(count) {
  const every = Math.max(1, Math.round(1 / RATE / scene.step)), begun = performance.now();
  const one = loop.closed || pointer;  // these inputs change in each step
  let done = 0, before = loop.given;
  while (done < count && !diverged) {
    const part = one ? 1 : Math.min(count - done, every - unsampled);
    command();
    if (!arm.step(part)) {
      diverged = true;
      running = false;
    }
    done += part;
    unsampled += part;
    // The largest torque is that of the step in which the goal jumps.
    if (unsampled >= every || loop.given !== before) sample();
    before = loop.given;
    if (done % 8 < part && performance.now() - begun > BUDGET) break;
  }
  values = arm.outputs();
  return done;
}

// The place in the world of an event in the picture.
function inWorld({ clientX, clientY }) {
  const box = byId('plane').getBoundingClientRect();
  return [view.x + (clientX - box.left - 0.5 * view.width) / view.pixels,
          view.y - (clientY - box.top - 0.5 * view.height) / view.pixels];
}

function frame(now) {
  const passed = Math.min(now - last, 100) / 1000;
  last = now;
  if (pointer) [pointer.x, pointer.y] = inWorld(pointer);
  if (running) {
    owed += passed * Number(byId('speed').value) / scene.step;
    const count = Math.floor(owed), done = count ? advance(count) : 0;
    owed -= count;
    behind = 0.95 * behind + 0.05 * (count ? 1 - done / count : 0);
  }
  if (wanted(now)) draw();
}

// While time stands, a picture now and then is enough.
let drawn = 0;
function wanted(now) {
  if (!running && now - drawn < 100 && !pointer) return false;
  drawn = now;
  return true;
}

function fit(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  const width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext('2d');
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, box.width, box.height);
  return [context, box.width, box.height];
}

let colours = {};
function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ['card', 'line', 'grid', 'ink', 'soft', 'arm', 'load', 'trail', 'body', 'second'])
    colours[name] = style.getPropertyValue(`--${name}`).trim();
}
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', readColours);

// The next of 1, 2, 5, 10, ... above a value.
function nice(value) {
  const ten = 10 ** Math.floor(Math.log10(value));
  return ten * [1, 2, 5, 10].find(each => each * ten >= value * (1 - 1e-9));
}

function arrow(context, x, y, dx, dy) {
  const length = Math.hypot(dx, dy);
  if (length < 3) return;
  const [ux, uy] = [dx / length, dy / length], head = Math.min(10, 0.5 * length);
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(x + dx - 0.6 * head * ux, y + dy - 0.6 * head * uy);
  context.stroke();
  context.beginPath();
  context.moveTo(x + dx, y + dy);
  context.lineTo(x + dx - head * ux - 0.45 * head * uy, y + dy - head * uy + 0.45 * head * ux);
  context.lineTo(x + dx - head * ux + 0.45 * head * uy, y + dy - head * uy - 0.45 * head * ux);
  context.fill();
}

// The drawn centre line: `factor` times as far from the straight arm as it is.
function drawnLine(factor) {
  const line = arm.shape(), { carrier_x: x, carrier_y: y, shaft } = values;
  const own = scene.body.length - scene.hub, cosine = Math.cos(shaft), sine = Math.sin(shaft);
  const points = [];
  for (let k = 0; k < POINTS; ++k) {
    const lever = scene.hub + own * k / (POINTS - 1);
    const straight = [x + lever * cosine, y + lever * sine];
    points.push(straight.map((value, axis) => value + factor * (line[2 * k + axis] - value)));
  }
  return points;
}

function drawPlane() {
  const [context, width, height] = fit(byId('plane'));
  const { body, hub, free, gravity } = scene, { carrier_x: x, carrier_y: y, shaft } = values;
  const pixels = 0.5 * Math.min(width, height) / (1.12 * body.length);
  const place = ([a, b]) => [0.5 * width + (a - x) * pixels, 0.5 * height - (b - y) * pixels];
  const path = points => {
    context.beginPath();
    points.forEach((each, k) => context[k ? 'lineTo' : 'moveTo'](...place(each)));
    context.stroke();
  };
  view = { x, y, pixels, width, height };

  // A grid of the world, behind a carrier that stays in the middle.
  const mesh = nice(60 / pixels);
  context.strokeStyle = colours.grid;
  context.lineWidth = 1;
  context.beginPath();
  for (let k = Math.ceil((x - 0.5 * width / pixels) / mesh); k * mesh < x + 0.5 * width / pixels; ++k) {
    const [at] = place([k * mesh, 0]);
    context.moveTo(at, 0);
    context.lineTo(at, height);
  }
  for (let k = Math.ceil((y - 0.5 * height / pixels) / mesh); k * mesh < y + 0.5 * height / pixels; ++k) {
    const [, at] = place([0, k * mesh]);
    context.moveTo(0, at);
    context.lineTo(width, at);
  }
  context.stroke();
  context.fillStyle = context.strokeStyle = colours.soft;
  context.font = '12px system-ui, sans-serif';
  context.textBaseline = 'bottom';
  context.beginPath();
  context.moveTo(10, height - 14);
  context.lineTo(10, height - 10);
  context.lineTo(10 + mesh * pixels, height - 10);
  context.lineTo(10 + mesh * pixels, height - 14);
  context.stroke();
  context.fillText(`${figure(mesh)} m`, 14, height - 12);
  const factor = SCALES[byId('scale').value];
  if (factor > 1) {
    context.textAlign = 'right';
    context.fillText(`deflection x ${factor}`, width - 8, height - 8);
    context.textAlign = 'left';
  }
  if (gravity[0] || gravity[1]) {
    const size = 34 / Math.hypot(...gravity);
    context.lineWidth = 1.5;
    arrow(context, width - 30 - 0.5 * size * gravity[0], 34 + 0.5 * size * gravity[1],
          size * gravity[0], -size * gravity[1]);
    context.fillText('g', width - 20, 40);
  }

  const line = drawnLine(factor), tip = line[POINTS - 1];
  if (!trail.length || values.time > trail[trail.length - 1].time) trail.push({ time: values.time, at: tip });
  while (trail.length && trail[0].time < values.time - TRAIL) trail.shift();
  context.strokeStyle = colours.trail;
  context.lineWidth = 2.5;
  for (let k = 1; k < trail.length; ++k) {
    context.globalAlpha = 0.85 * (1 - (values.time - trail[k].time) / TRAIL);
    path([trail[k - 1].at, trail[k].at]);
  }
  context.globalAlpha = 1;
  context.lineJoin = context.lineCap = 'round';

  const direction = [Math.cos(shaft), Math.sin(shaft)];
  const along = lever => [x + lever * direction[0], y + lever * direction[1]];
  context.strokeStyle = colours.soft;
  context.lineWidth = 1;
  context.setLineDash([5, 5]);
  path([[x, y], along(body.length)]);
  if (loop.closed && !law.why) {
    const goal = loop.goalAt(values.time);
    context.strokeStyle = colours.second;
    path([[x, y], [x + body.length * Math.cos(goal), y + body.length * Math.sin(goal)]]);
  }
  context.setLineDash([]);

  // Carrier, hub, arm, end effector.
  const [cx, cy] = place([x, y]), half = Math.max(11, 0.5 * body.carrier * pixels);
  context.fillStyle = colours.card;
  context.strokeStyle = colours.body;
  context.lineWidth = 2;
  context.beginPath();
  context.rect(cx - half, cy - half, 2 * half, 2 * half);
  context.fill();
  context.stroke();
  if (!free[0] || !free[1]) {  // it is held: on the ground
    context.lineWidth = 1;
    context.beginPath();
    for (let k = 0; k < 4; ++k) {
      context.moveTo(cx - half + k * half * 0.55 + 4, cy + half);
      context.lineTo(cx - half + k * half * 0.55 - 2, cy + half + 7);
    }
    context.stroke();
  }
  context.strokeStyle = colours.arm;
  context.lineWidth = Math.max(5, body.thickness * pixels);
  path(line);
  const root = Math.max(6, hub * pixels, 0.4 * body.motor * pixels);
  context.fillStyle = colours.body;
  context.beginPath();
  context.arc(cx, cy, root, 0, 2 * Math.PI);
  context.fill();
  context.strokeStyle = colours.card;
  context.lineWidth = 2;
  context.beginPath();
  context.moveTo(cx, cy);
  context.lineTo(cx + root * direction[0], cy - root * direction[1]);
  context.stroke();
  const [tx, ty] = place(tip);
  context.fillStyle = colours.arm;
  context.strokeStyle = colours.card;
  context.lineWidth = 1.5;
  context.beginPath();
  context.arc(tx, ty, Math.max(7, 0.5 * body.end_effector * pixels), 0, 2 * Math.PI);
  context.fill();
  context.stroke();

  // Loads: lengths saturate, so that small and large ones are seen.
  context.strokeStyle = context.fillStyle = colours.load;
  context.lineWidth = 2.5;
  const grow = (size, range) => 0.42 * body.length * pixels * size / (size + (range || 1)) / size;
  const { ranges } = scene;
  const push = [free[0] ? values.carrier_x_force : 0, free[1] ? values.carrier_y_force : 0];
  let size = Math.hypot(...push);
  if (size > 1e-9) {
    const factor = grow(size, 0.5 * (ranges.force_x || ranges.force_y));
    arrow(context, cx, cy, push[0] * factor, -push[1] * factor);
  }
  const across = manual.tip_force_across_arm, turn = values.tip_rotation, [px, py] = arm.pull || [0, 0];
  const pull = [px - across * Math.sin(turn), py + across * Math.cos(turn)];
  size = Math.hypot(...pull);
  if (size > 1e-9) {
    const factor = grow(size, ranges.tip_force_across_arm);
    arrow(context, tx, ty, pull[0] * factor, -pull[1] * factor);
  }
  if (pointer) {
    context.setLineDash([2, 4]);
    context.lineWidth = 1.5;
    path([tip, [pointer.x, pointer.y]]);
    context.setLineDash([]);
    context.lineWidth = 2.5;
  }
  const torque = values.shaft_torque, share = torque / (Math.abs(torque) + 0.3 * (ranges.torque || 1));
  if (Math.abs(share) > 0.06) {  // an arc, longer than its head, around the hub, from the arm on
    const radius = Math.max(half * 1.5, root + 9), end = 1.5 * Math.PI * share;
    context.beginPath();
    context.arc(cx, cy, radius, -shaft, -shaft - end, end > 0);
    context.stroke();
    const at = -shaft - end, sense = -Math.sign(end);
    const [ax, ay] = [cx + radius * Math.cos(at), cy + radius * Math.sin(at)];
    context.beginPath();
    context.moveTo(ax - sense * 9 * Math.sin(at), ay + sense * 9 * Math.cos(at));
    context.lineTo(ax + 5 * Math.cos(at), ay + 5 * Math.sin(at));
    context.lineTo(ax - 5 * Math.cos(at), ay - 5 * Math.sin(at));
    context.fill();
  }
}

const PANELS = [
  { key: 'deflection', label: 'deflection of the tip', unit: 'mm', factor: 1e3, least: 0.1 },
  { key: 'strain', label: 'strain at the root', unit: 'µm/m', factor: 1e6, least: 1 },
  { key: 'shaft', label: 'shaft angle', unit: 'rad', factor: 1, least: 0.02, also: 'goal' },
  { key: 'torque', label: 'torque at the shaft', unit: 'N m', factor: 1, least: 0.01 }];

function drawCurves() {
  const [context, width, height] = fit(byId('curves'));
  const left = 52, bottom = 20, each = (height - bottom) / PANELS.length;
  const end = Math.max(values.time, WINDOW), begin = end - WINDOW;
  const right = width - 12;
  const across = time => left + (right - left) * (time - begin) / WINDOW;
  context.font = '12px system-ui, sans-serif';
  context.lineJoin = 'round';
  PANELS.forEach((panel, number) => {
    const top = number * each + 22, base = (number + 1) * each - 6;
    let low = Infinity, high = -Infinity;
    for (const sample of samples)
      for (const key of [panel.key, panel.also])
        if (key && Number.isFinite(sample[key])) {
          low = Math.min(low, sample[key] * panel.factor);
          high = Math.max(high, sample[key] * panel.factor);
        }
    if (!(high >= low)) [low, high] = [0, 0];
    const gap = nice(Math.max(high - low, panel.least) / clamp((base - top) / 36, 1, 3));
    low = Math.floor(low / gap) * gap;
    high = Math.max(Math.ceil(high / gap) * gap, low + gap);
    const digits = clamp(Math.ceil(-1e-9 - Math.log10(gap)), 0, 9);
    const up = value => base - (base - top) * (value - low) / (high - low);
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    context.fillStyle = colours.soft;
    context.textAlign = 'right';
    context.textBaseline = 'middle';
    context.beginPath();
    for (let value = low; value <= high + 0.5 * gap; value += gap) {
      context.moveTo(left, up(value));
      context.lineTo(right, up(value));
      context.fillText((value + 0).toFixed(digits).replace(/^-(?=0\.?0*$)/, '').replace('-', '−'),
                       left - 6, up(value));
    }
    for (let time = Math.ceil(begin / 2) * 2; time <= end; time += 2) {
      context.moveTo(across(time), top);
      context.lineTo(across(time), base);
    }
    context.stroke();
    context.textAlign = 'left';
    context.fillStyle = colours.ink;
    context.fillText(`${panel.label} [${panel.unit}]`, left, top - 12);
    const curve = (key, colour, dash) => {
      context.strokeStyle = colour;
      context.lineWidth = 1.8;
      context.setLineDash(dash);
      context.beginPath();
      let joined = false;
      for (const sample of samples) {
        if (Number.isFinite(sample[key])) {
          context[joined ? 'lineTo' : 'moveTo'](across(sample.time), up(sample[key] * panel.factor));
          joined = true;
        } else joined = false;
      }
      context.stroke();
      context.setLineDash([]);
    };
    if (panel.also && loop.closed) {
      curve(panel.also, colours.second, [5, 4]);
      context.textAlign = 'right';
      context.fillStyle = colours.second;
      context.fillText('goal', right, top - 12);
    }
    curve(panel.key, panel.key === 'torque' ? colours.load : colours.arm, []);
  });
  context.fillStyle = colours.soft;
  context.textBaseline = 'bottom';
  context.textAlign = 'center';
  for (let time = Math.ceil(begin / 2) * 2; time <= end; time += 2)
    context.fillText(time === Math.ceil(begin / 2) * 2 ? `${time} s` : time, across(time), height - 3);
}

function drawTexts() {
  const error = values.estimated_tip_error;
  byId('clock').textContent = `t = ${values.time.toFixed(2)} s` +
    (error === undefined ? '' : `, estimated tip error ${figure(1e6 * error)} µm`) +
    (running && behind > 0.1 ? ', slower than wanted' : '');
  const [before, after, most] = scene.warning;
  byId('warning').textContent = diverged ?
    'The run diverged and stands at its last good step: reset it.' :
    Number.isNaN(error) ? 'The finer run diverged: the error is not known.' :
    error > most ? `${before}${error.toExponential(0)} m${after}` : '';
  // What is left of the vibration in its last two periods, after the goal was reached.
  let text = '';
  if (loop.closed && !law.why && law.frequency) {
    const { time, times } = loop.goal, reached = time + times[times.length - 1];
    const since = Math.max(reached + 0.02, values.time - 2 / law.frequency);
    const part = samples.filter(each => each.time >= since).map(each => each.deflection);
    if (loop.goal.from !== loop.goal.to && values.time > reached + 2 / law.frequency && part.length > 2)
      text = `Amplitude of the tip in the last ${figure(2 / law.frequency)} s: ` +
        `${figure(500 * (Math.max(...part) - Math.min(...part)))} mm.`;
  }
  byId('left').textContent = text;
  byId('run').textContent = running ? 'Pause' : 'Run';
}

function draw() {
  drawPlane();
  drawCurves();
  drawTexts();
}

function listen() {
  const on = (id, kind, call) => byId(id).addEventListener(kind, call);
  on('run', 'click', () => { running = !running && !diverged; });
  on('step', 'click', () => { running = false; advance(1); sample(); });
  on('reset', 'click', () => {
    for (const input of byId('inputs').querySelectorAll('input')) {
      input.value = 0;
      input.dispatchEvent(new Event('input'));
    }
    reset();
  });
  on('scene', 'change', event => show(Number(event.target.value)));
  on('closed', 'change', event => {
    loop.closed = event.target.checked;
    loop.hold(values.time, values.shaft);
  });
  const begin = sign => {
    if (!loop.closed) {
      byId('closed').checked = loop.closed = true;
      loop.hold(values.time, values.shaft);
    }
    const to = loop.goal.to + sign * Number(byId('size').value);
    loop.begin(values.time, to, law, byId('shaped').checked);
    running = !diverged;
  };
  on('forth', 'click', () => begin(1));
  on('back', 'click', () => begin(-1));
  for (const [id, text] of [['size', value => figure(Number(value))], ['scale', value => `x ${SCALES[value]}`]]) {
    const tell = () => { byId(id).nextElementSibling.textContent = text(byId(id).value); };
    on(id, 'input', tell);
    tell();
  }
  on('scale', 'input', () => { trail = []; });
  const key = event => (event.key.length === 1 ? event.key.toLowerCase() : event.key);
  addEventListener('keydown', event => {
    if (event.target.matches('input, select') || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === ' ' && event.target.matches('button')) return;
    const press = { ' ': 'run', '.': 'step', r: 'reset' }[key(event)];
    if (press) byId(press).click();
    else held.add(key(event));
    if (press || event.key.startsWith('Arrow')) event.preventDefault();
  });
  addEventListener('keyup', event => held.delete(key(event)));
  addEventListener('blur', () => held.clear());
  const plane = byId('plane');
  plane.addEventListener('pointerdown', event => {
    const { clientX, clientY } = event, [x, y] = inWorld(event);
    if (Math.hypot(x - values.tip_x, y - values.tip_y) * view.pixels > REACH) return;
    plane.setPointerCapture(event.pointerId);
    pointer = { clientX, clientY, x, y, before: [] };
  });
  // A finger on the tip does not scroll the page.
  plane.addEventListener('touchstart', event => {
    if (pointer) event.preventDefault();
  }, { passive: false });
  plane.addEventListener('pointermove', event => {
    if (pointer) [pointer.clientX, pointer.clientY] = [event.clientX, event.clientY];
  });
  for (const kind of ['pointerup', 'pointercancel'])
    plane.addEventListener(kind, () => { pointer = null; });
}

async function show(number) {
  scene = null;
  const loaded = await load(scenes[number]);
  [arm, scene] = [loaded, loaded.scene];
  loop.closed = byId('closed').checked = false;
  values = arm.outputs();
  build();
  reset();
}

async function main() {
  readColours();
  scenes.forEach((each, number) => byId('scene').add(new Option(each.name, number)));
  byId('scene').style.display = scenes.length > 1 ? '' : 'none';
  if (typeof DecompressionStream === 'undefined')
    throw new Error('this browser is too old: it has no DecompressionStream');
  await show(0);
  listen();
  last = performance.now();
  requestAnimationFrame(function first(now) {
    requestAnimationFrame(first);
    if (scene) frame(now);
  });
}

main().catch(error => {
  byId('warning').textContent = `The arm cannot be shown: ${error.message}.`;
  throw error;
});
