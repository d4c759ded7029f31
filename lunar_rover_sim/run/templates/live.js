// The page of the live view: camera, map and path, plots; a stick that drives a rover, or the time
// line of a recording.
// It speaks the websocket protocol of Foxglove to the server that served it.
'use strict';

const PROTOCOL = 'foxglove.sdk.v1';
const IMAGE = 'sensor_msgs/msg/Image';
const SHOWABLE = /(image_raw|image_color|depth\/image|shadow)$/;
const TWIST = 'geometry_msgs/msg/Twist';
const SHOWN_S = 10, PLOT_STEP_S = 0.02, PATH_STEP_M = 0.01;
const MAX_AHEAD_MPS = 0.2, MAX_TURN_RADPS = 0.6, SEND_MS = 100, FACTS_MS = 2000;
const DRIVE_CHANNEL = 1;
const COLOURS = ['#e0a030', '#4aa3df', '#7bc96f', '#d65c5c', '#b58bd9', '#c9c9c9'];

const element = (id) => document.getElementById(id);
const channels = new Map();       // topic -> channel of the server
const handlers = new Map();       // topic -> what takes its messages
const subscriptions = new Map();  // number -> topic
let socket, facts = {}, scope = null, nextSubscription = 1, image = '';
let path = [], pose = null, sun = null, series = {}, nowS = 0, shown = 0;
let stick = {ahead: 0, turn: 0}, drivable = false, wasDriving = false, wantsFrame = false;
let recording = null, seeking = false;     // {first, last [s], playing, speed}

// Connection

function connect() {
  socket = new WebSocket(`ws://${location.host}/${location.search}`, [PROTOCOL]);
  socket.binaryType = 'arraybuffer';
  socket.onopen = () => { element('time').textContent = 'waiting for topics'; };
  socket.onclose = () => {
    element('time').textContent = 'the run has ended, or is out of reach';
    for (const kept of [channels, handlers, subscriptions]) kept.clear();
    scope = null;
    setTimeout(connect, 1000);
  };
  socket.onmessage = (event) => {
    if (typeof event.data === 'string') told(JSON.parse(event.data));
    else received(event.data);
  };
}

function told(message) {
  if (message.op === 'serverInfo') informed(message);
  if (message.op === 'advertise') message.channels.forEach(offered);
  if (message.op === 'unadvertise') {
    for (const [topic, channel] of channels) {
      if (message.channelIds.includes(channel.id)) channels.delete(topic);
    }
  }
}

function informed({capabilities, dataStartTime, dataEndTime}) {
  drivable = capabilities.includes('clientPublish');
  element('driving').hidden = !drivable;
  element('player').hidden = !dataStartTime;
  if (!dataStartTime) return;
  const [first, last] = [dataStartTime, dataEndTime].map((time) => time.sec + 1e-9 * time.nsec);
  recording = {first, last, playing: true, speed: 1};
  Object.assign(element('seek'), {min: first, max: last, value: first});
  element('end').textContent = `${last.toFixed(2)} s`;
}

function offered(channel) {
  channel.parsed = parseSchema(channel.schemaName, channel.schema);
  channels.set(channel.topic, channel);
  if (handlers.has(channel.topic)) ask(channel.topic);   // offered anew: asked anew
  if (scope === null) findRover(channel);
  if (channel.schemaName === IMAGE) listImages();
}

// The rover is that of ?rover=NAME, or the first one whose odometry is offered.
function findRover(channel) {
  const named = new URLSearchParams(location.search).get('rover');
  const found = channel.topic.match(/^(.*)\/(ground_truth\/)?odom$/);
  if (!found || channel.schemaName !== 'nav_msgs/msg/Odometry') return;
  if (named !== null && found[1] !== `/${named}`) return;
  scope = found[1];
  watch(channel.topic, onOdometry);
  watch(`${scope}/sun`, (message) => { sun = message.vector; });
  watch(`${scope}/map/traversability`, onGrid);
  if (drivable) {
    socket.send(JSON.stringify({op: 'advertise', channels: [
      {id: DRIVE_CHANNEL, topic: `${scope}/cmd_vel`, encoding: 'cdr', schemaName: TWIST}]}));
  }
  for (const topic of channels.keys()) watchContact(topic);
  listImages();
}

function watch(topic, handler) {
  handlers.set(topic, handler);
  if (channels.has(topic)) ask(topic);
}

function ask(topic) {
  for (const [number, of] of subscriptions) if (of === topic) subscriptions.delete(number);
  const number = nextSubscription++;
  subscriptions.set(number, topic);
  socket.send(JSON.stringify({op: 'subscribe',
    subscriptions: [{id: number, channelId: channels.get(topic).id}]}));
}

function leave(topic) {
  handlers.delete(topic);
  for (const [number, of] of subscriptions) {
    if (of !== topic) continue;
    subscriptions.delete(number);
    socket.send(JSON.stringify({op: 'unsubscribe', subscriptionIds: [number]}));
  }
}

function received(buffer) {
  const view = new DataView(buffer);
  if (view.getUint8(0) === 2) showTime(Number(view.getBigUint64(1, true)) * 1e-9);
  if (view.getUint8(0) === 5) played(view);
  if (view.getUint8(0) !== 1) return;
  const topic = subscriptions.get(view.getUint32(1, true));
  const handler = handlers.get(topic), channel = channels.get(topic);
  if (!handler || !channel) return;
  const stampS = Number(view.getBigUint64(5, true)) * 1e-9;
  handler(decode(channel.parsed, new Uint8Array(buffer, 13)), stampS, topic);
  if (!wantsFrame) {
    wantsFrame = true;
    requestAnimationFrame(() => { wantsFrame = false; drawMap(); drawPlots(); });
  }
}

function showTime(timeS) {
  nowS = timeS;
  element('time').textContent = `${nowS.toFixed(2)} s`;
  if (!seeking) element('seek').value = nowS;
}

// Time line of a recording

function played(view) {
  recording.playing = view.getUint8(1) === 0;
  recording.speed = view.getFloat32(10, true);
  element('play').textContent = recording.playing ? 'pause' : 'play';
  showTime(Number(view.getBigUint64(2, true)) * 1e-9);
  if (view.getUint8(14)) [path, series, pose] = [[], {}, null];     // it has jumped
}

function control(playing, seekS = null) {
  if (!recording || socket.readyState !== 1) return;
  const request = new DataView(new ArrayBuffer(19));
  const time = Math.min(Math.max(seekS ?? 0, recording.first), recording.last);
  request.setUint8(0, 3);
  request.setUint8(1, playing ? 0 : 1);
  request.setFloat32(2, recording.speed, true);
  request.setUint8(6, seekS === null ? 0 : 1);
  request.setBigUint64(7, BigInt(Math.round(1e9 * time)), true);
  socket.send(request);
}

element('play').addEventListener('click', (event) => {
  event.target.blur();      // or the space bar presses it again
  control(!recording.playing);
});
element('seek').addEventListener('input', (event) => {
  seeking = true;
  control(recording.playing, Number(event.target.value));
});
element('seek').addEventListener('change', () => { seeking = false; });

// Camera

function listImages() {
  const list = element('topics');
  const topics = [...channels.values()].filter((one) => one.schemaName === IMAGE)
    .map((one) => one.topic).filter((topic) => scope !== null && topic.startsWith(`${scope}/`)
      && SHOWABLE.test(topic)).sort();
  if (topics.length === list.options.length) return;
  list.replaceChildren(...topics.map((topic) => new Option(topic.slice(scope.length + 1), topic)));
  if (!image) showImage(`${scope}/stereo/left/image_raw`);
  list.value = image;
}

function showImage(topic) {
  if (image) leave(image);
  image = topic;
  watch(topic, onImage);
}

function onImage(message) {
  const {width, height, encoding, step, data} = message;
  const canvas = element('camera'), context = canvas.getContext('2d');
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  const picture = context.createImageData(width, height), to = picture.data;
  const view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const little = !message.is_bigendian;
  const eight = (at) => data[at], sixteen = (at) => view.getUint16(at, little) >> 8;
  const grey = {mono8: eight, mono16: sixteen,
    // Near is bright.
    '32FC1': (at) => 255 / (1 + 0.5 * view.getFloat32(at, little))}[encoding];
  const mosaic = {bayer_rggb8: eight, bayer_rggb16: sixteen}[encoding];
  const size = {mono8: 1, mono16: 2, '32FC1': 4, rgb8: 3, bgr8: 3, bayer_rggb8: 1,
    bayer_rggb16: 2}[encoding];
  if (!size) {
    element('note').textContent = `${encoding}: this page cannot show such images`;
    return;
  }
  for (let row = 0, pixel = 0; row < height; row++) {
    const start = row * step;
    for (let at = start, end = at + width * size; at < end; at += size, pixel += 4) {
      if (grey) to[pixel] = to[pixel + 1] = to[pixel + 2] = grey(at);
      else if (mosaic) {      // red, green and blue of the 2 x 2 pixels of its cell
        const cell = at - (row % 2) * step - (at - start) % (2 * size);
        to[pixel] = mosaic(cell);
        to[pixel + 1] = mosaic(cell + size);
        to[pixel + 2] = mosaic(cell + step + size);
      }
      else for (let k = 0; k < 3; k++) to[pixel + k] = data[at + (encoding === 'rgb8' ? k : 2 - k)];
      to[pixel + 3] = 255;
    }
  }
  context.putImageData(picture, 0, 0);
  shown += 1;
}

// Odometry and forces

function plot(name, label, stampS, value) {
  const plotted = (series[name] ??= {}), line = (plotted[label] ??= []);
  if (line.length && stampS < line[line.length - 1][0]) line.length = 0;    // it begins anew
  if (line.length && stampS - line[line.length - 1][0] < PLOT_STEP_S) return;
  line.push([stampS, value]);
  while (line[0][0] < stampS - SHOWN_S) line.shift();
}

function onOdometry(message, stampS) {
  const {position: p, orientation: q} = message.pose.pose, degrees = 180 / Math.PI;
  const yaw = Math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z));
  if (pose && stampS < pose.stampS) path = [];     // time has begun anew
  pose = {x: p.x, y: p.y, yaw, stampS};
  const last = path[path.length - 1];
  if (last && Math.hypot(p.x - last[0], p.y - last[1]) > 1) path = [];    // placed anew
  if (!last || Math.hypot(p.x - last[0], p.y - last[1]) > PATH_STEP_M) path.push([p.x, p.y]);
  plot('pitch, roll [deg]', 'pitch', stampS,
    degrees * Math.asin(Math.max(-1, Math.min(1, 2 * (q.w * q.y - q.z * q.x)))));
  plot('pitch, roll [deg]', 'roll', stampS,
    degrees * Math.atan2(2 * (q.w * q.x + q.y * q.z), 1 - 2 * (q.x * q.x + q.y * q.y)));
  plot('speed ahead [m/s]', 'speed', stampS, message.twist.twist.linear.x);
  for (const topic of channels.keys()) watchContact(topic);
}

function watchContact(topic) {
  if (!topic.startsWith(`${scope}/contacts/`) || handlers.has(topic)) return;
  watch(topic, (message, stampS) => {
    const f = message.wrench.force;
    plot('ground reaction [N]', topic.split('/').pop(), stampS, Math.hypot(f.x, f.y, f.z));
  });
}

// Map

let relief = null, grid = null, asked = '';

function onGrid(message) {
  const {width, height, resolution, origin} = message.info;
  const canvas = new OffscreenCanvas(width, height), context = canvas.getContext('2d');
  const picture = context.createImageData(width, height);
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const cost = message.data[(height - 1 - row) * width + column];
      const at = 4 * (row * width + column);
      picture.data.set(cost < 0 ? [0, 0, 0, 0] : [2.55 * cost, 255 - 2.55 * cost, 60, 90], at);
    }
  }
  context.putImageData(picture, 0, 0);
  grid = {canvas, x: origin.position.x, y: origin.position.y, width: width * resolution,
    height: height * resolution};
}

function drawMap() {
  const canvas = element('map'), context = canvas.getContext('2d');
  const {width, height} = canvas;
  context.fillStyle = '#000';
  context.fillRect(0, 0, width, height);
  if (!pose) return;
  const xs = path.map((p) => p[0]), ys = path.map((p) => p[1]);
  const low = [Math.min(pose.x, ...xs.slice(-4000)), Math.min(pose.y, ...ys.slice(-4000))];
  const high = [Math.max(pose.x, ...xs.slice(-4000)), Math.max(pose.y, ...ys.slice(-4000))];
  const centre = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
  const span = Math.max(3, 1.4 * (high[1] - low[1]), 1.4 * (high[0] - low[0]) * height / width);
  const scale = height / span;
  const at = (x, y) => [width / 2 + scale * (x - centre[0]), height / 2 - scale * (y - centre[1])];
  const place = (picture, x, y, w, h) => {
    const [left, top] = at(x, y + h);
    context.drawImage(picture, left, top, scale * w, scale * h);
  };
  if (relief) place(relief.picture, relief.x, relief.y, relief.width, relief.width);
  if (grid) place(grid.canvas, grid.x, grid.y, grid.width, grid.height);
  context.fillStyle = '#9a7b4f';
  for (const [x, y, radius] of facts.rocks ?? []) {
    const [left, top] = at(x, y);
    context.beginPath();
    context.arc(left, top, Math.max(1.5, scale * radius), 0, 2 * Math.PI);
    context.fill();
  }
  context.strokeStyle = '#e0a030';
  context.lineWidth = 2;
  context.beginPath();
  for (const [x, y] of path) context.lineTo(...at(x, y));
  context.stroke();
  arrow(context, at(pose.x, pose.y), pose.yaw, 16, '#4aa3df');
  if (sun) arrow(context, [40, 40], Math.atan2(sun.y, sun.x), 22, '#ffe27a', 'sun');
  element('scale').textContent = `${(width / scale).toFixed(1)} m wide, north up` +
    ((facts.rocks ?? []).length ? ', rocks brown' : '');
}

function arrow(context, [x, y], angle, length, colour, label = '') {
  context.save();
  context.translate(x, y);
  context.fillStyle = colour;
  context.fillText(label, -10, 34);
  context.rotate(-angle);
  context.beginPath();
  context.moveTo(length, 0);
  context.lineTo(-0.6 * length, 0.5 * length);
  context.lineTo(-0.3 * length, 0);
  context.lineTo(-0.6 * length, -0.5 * length);
  context.fill();
  context.restore();
}

// Plots

function drawPlots() {
  const canvas = element('plots'), context = canvas.getContext('2d');
  const names = Object.keys(series), height = canvas.height / Math.max(1, names.length);
  context.fillStyle = '#000';
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.font = '13px system-ui, sans-serif';
  names.forEach((name, k) => {
    const lines = Object.entries(series[name]), values = lines.flatMap(([, l]) => l.map((p) => p[1]));
    const end = Math.max(...lines.map(([, l]) => l[l.length - 1][0]));
    const low = Math.min(0, ...values), high = Math.max(1e-3, ...values), span = high - low;
    const top = k * height + 22, tall = height - 32;
    context.fillStyle = '#999';
    context.fillText(`${name}: ${low.toFixed(2)} to ${high.toFixed(2)}`, 8, k * height + 15);
    lines.forEach(([label, line], n) => {
      context.strokeStyle = context.fillStyle = COLOURS[n % COLOURS.length];
      context.fillText(label, canvas.width - 90 * (lines.length - n), k * height + 15);
      context.beginPath();
      for (const [time, value] of line) {
        context.lineTo(canvas.width * (1 - (end - time) / SHOWN_S),
          top + tall * (1 - (value - low) / span));
      }
      context.stroke();
    });
  });
}

// Driving

function drive() {
  const moves = stick.ahead !== 0 || stick.turn !== 0, others = facts.drivers ?? [];
  element('pad').classList.toggle('off', others.length > 0);
  element('drive').textContent = others.length ?
    `${others.join(', ')} publishes cmd_vel; start the run with --teleop to drive here` :
    `${stick.ahead.toFixed(2)} m/s ahead, ${stick.turn.toFixed(2)} rad/s to the left`;
  if (scope !== null && drivable && !others.length && (moves || wasDriving) && socket.readyState === 1) {
    const twist = encodeTwist(stick.ahead, stick.turn), bytes = new Uint8Array(5 + twist.length);
    bytes[0] = 1;
    new DataView(bytes.buffer).setUint32(1, DRIVE_CHANNEL, true);
    bytes.set(twist, 5);
    socket.send(bytes);
    wasDriving = moves;       // a last one that stops
  }
}

function pull(right, up) {
  stick = {ahead: MAX_AHEAD_MPS * up, turn: -MAX_TURN_RADPS * right};
  element('knob').style.left = `${39 + 39 * right}%`;
  element('knob').style.top = `${39 - 39 * up}%`;
}

function followPointer(event) {
  const box = element('pad').getBoundingClientRect();
  const right = 2 * (event.clientX - box.left) / box.width - 1;
  const up = 1 - 2 * (event.clientY - box.top) / box.height;
  const reach = Math.max(1, Math.hypot(right, up));
  pull(right / reach, up / reach);
}

const pressed = new Set();
function followKeys() {
  const on = (key) => (pressed.has(key) ? 1 : 0);
  pull(0.6 * (on('ArrowRight') - on('ArrowLeft')), on('ArrowUp') - on('ArrowDown'));
}

element('pad').addEventListener('pointerdown', (event) => {
  element('pad').setPointerCapture(event.pointerId);
  followPointer(event);
});
element('pad').addEventListener('pointermove', (event) => { if (event.buttons) followPointer(event); });
for (const end of ['pointerup', 'pointercancel']) {
  element('pad').addEventListener(end, () => pull(0, 0));
}
addEventListener('keydown', (event) => {
  if (recording && event.key === ' ') control(!recording.playing);
  else if (recording && event.key === 'ArrowLeft') control(recording.playing, nowS - 1);
  else if (recording && event.key === 'ArrowRight') control(recording.playing, nowS + 1);
  else if (!event.key.startsWith('Arrow')) return;
  event.preventDefault();
  if (recording) return;
  pressed.add(event.key);
  followKeys();
});
addEventListener('keyup', (event) => { if (pressed.delete(event.key)) followKeys(); });
addEventListener('blur', () => { pressed.clear(); pull(0, 0); });
element('topics').addEventListener('change', (event) => showImage(event.target.value));

async function askFacts() {
  try {
    facts = await (await fetch('live.json' + location.search)).json();
    const half = facts.half_extent_m, middle = facts.middle_m;
    if (half && asked !== String(middle)) {     // another window of the site
      asked = String(middle);
      const picture = new Image(), [x, y] = [middle[0] - half, middle[1] - half];
      picture.onload = () => { relief = { picture, x, y, width: 2 * half }; };
      picture.src = 'map.png' + location.search + (location.search ? '&' : '?') + 'at=' + asked;
    }
  } catch { /* the run has ended: the connection tells */ }
}

askFacts();
setInterval(askFacts, FACTS_MS);
setInterval(drive, SEND_MS);
connect();
