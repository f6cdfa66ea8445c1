// The page: controls of the keys that the simulator describes, the state in the address line, and what comes back.
'use strict';

const $ = id => document.getElementById(id);
const worker = new Worker('worker.js');
const calm = matchMedia('(prefers-reduced-motion: reduce)');

let keys = []; // as the simulator describes them
let presets = [];
let texts = {}; // what differs from the defaults
let at = 0; // the cycle that is looked at
let range = [0, 0];
let show = 0;
let playing = false;

// ---- The simulator: one question at a time, and of those that wait only the last.

let number = 0;
let busy = null;
let waiting = null;

function ask(question) {
  if (busy) { waiting = question; return; }
  busy = question;
  number += 1;
  document.body.classList.add('busy');
  worker.postMessage({ number, text: question.text });
}

worker.onmessage = ({ data }) => {
  const question = busy;
  busy = null;
  const next = waiting;
  waiting = null;
  if (next) ask(next); else document.body.classList.remove('busy');
  if (data.error) return fail(data.error);
  question.then(data.answer, data.took);
};
worker.onerror = error => { busy = null; fail(error.message || 'the simulator could not be started'); };

function fail(message) {
  stop();
  verdict(`The simulator can't go on: ${message}`, 'bad');
}

// ---- The state and the address line.

function fromHash() {
  const found = {};
  const text = location.hash.replace(/^#/, '');
  for (const pair of text.split('&').filter(Boolean)) {
    const [key, ...value] = pair.split('=');
    found[decode(key)] = decode(value.join('='));
  }
  return found;
}

function decode(text) {
  try { return decodeURIComponent(text.replaceAll('+', '%2B')); } catch { return text; }
}

function toHash(all) {
  const order = [...keys.map(key => key.name), 'at', 'show'];
  const names = Object.keys(all).sort((a, b) => order.indexOf(a) - order.indexOf(b));
  const plain = text => encodeURIComponent(text).replaceAll('%2B', '+');
  return '#' + names.map(name => `${plain(name)}=${plain(all[name])}`).join('&');
}

function whole() {
  const all = { ...texts };
  if (at !== 0) all.at = String(at);
  if (show !== 0) all.show = String(show);
  return all;
}

function write(how) {
  const hash = toHash(whole());
  if (hash === (location.hash || '#')) return;
  history[how === 'push' ? 'pushState' : 'replaceState'](null, '', hash === '#' ? location.pathname + location.search : hash);
}

function load() {
  stop();
  const found = fromHash();
  const whole = text => (/^-?\d+$/.test(text || '') ? Number(text) : 0);
  at = whole(found.at);
  show = whole(found.show);
  const extra = {};
  // What is no number is for the simulator to refuse.
  for (const look of ['at', 'show']) {
    if (found[look] !== undefined && !/^-?\d+$/.test(found[look])) extra[look] = found[look];
    delete found[look];
  }
  texts = found;
  fill();
  work(extra);
}

const keyOf = name => keys.find(key => key.name === name);
const text = name => texts[name] ?? keyOf(name).default;

function set(name, value, how) {
  const key = keyOf(name);
  const normal = value.trim() === '' ? key.default : value.trim();
  if (normal === key.default) delete texts[name]; else texts[name] = normal;
  // What no control has can't be mended by one.
  for (const other of Object.keys(texts)) if (!keyOf(other)) delete texts[other];
  if (name === 'mode') {
    // Keys that other modes have say nothing in this one.
    if (!['dc-shift-sync1', 'dc-sync1'].includes(normal)) delete texts.sync1;
    if (normal !== 'dc-subordinated') delete texts['sync0-cycle'];
  }
  if (name === 'view') for (const key of keys) if (!key.views.includes(normal)) delete texts[key.name];
  at = Math.max(at, 0);
  // What one writes or slides in one go is one step back.
  write(going === name ? 'replace' : 'push');
  going = how === 'go on' ? name : null;
  fill(document.activeElement);
  later();
}

let going = null; // the key that is being changed
let timer;
function later() {
  stop();
  clearTimeout(timer);
  timer = setTimeout(() => work(), 90);
}

// ---- Controls.

function build() {
  const fields = $('fields');
  const groups = new Map();
  for (const key of keys) {
    let group = groups.get(key.group);
    if (!group) {
      group = document.createElement(key.group ? 'fieldset' : 'div');
      if (key.group) group.append(element('legend', key.group));
      fields.append(group);
      groups.set(key.group, group);
    }
    group.append(field(key));
  }
  for (const preset of presets) $('preset').append(new Option(preset.title, preset.id));
}

function element(name, words = '', attributes = {}) {
  const made = document.createElement(name);
  made.textContent = words;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function field(key) {
  const id = `key-${key.name}`;
  const box = element('div', '', { class: 'field', 'data-key': key.name });
  box.append(element('label', key.label, { for: id }));
  const described = { 'aria-describedby': `${id}-help ${id}-problem` };
  if (key.kind.kind === 'choice') {
    const select = element('select', '', { id, ...described });
    for (const [word, words] of key.kind.choices) select.append(new Option(words, word));
    select.addEventListener('change', () => set(key.name, select.value, 'end'));
    box.append(select);
  } else if (key.kind.kind === 'lines') {
    const area = element('textarea', '', { id, rows: 3, spellcheck: 'false', placeholder: key.kind.example, ...described });
    area.addEventListener('input', () => set(key.name, area.value, 'go on'));
    area.addEventListener('change', () => set(key.name, area.value, 'end'));
    box.append(area);
  } else {
    const row = element('div', '', { class: 'number' });
    const stops = stopsOf(key);
    const slider = element('input', '', { type: 'range', min: 0, max: stops.length - 1, id: `${id}-slider`, 'aria-label': key.label });
    slider.addEventListener('input', () => {
      slider.setAttribute('aria-valuetext', stops[slider.value]);
      set(key.name, stops[slider.value], 'go on');
    });
    slider.addEventListener('change', () => set(key.name, stops[slider.value], 'end'));
    const input = element('input', '', { type: 'text', id, spellcheck: 'false', inputmode: 'text', ...described });
    if (key.kind.own) input.placeholder = key.kind.own;
    input.addEventListener('change', () => set(key.name, input.value || (key.kind.own ? 'own' : ''), 'end'));
    input.addEventListener('input', () => set(key.name, input.value || (key.kind.own ? 'own' : ''), 'go on'));
    input.addEventListener('keydown', event => nudge(event, key, input));
    row.append(slider, input);
    box.append(row);
  }
  box.append(element('p', key.help, { class: 'help', id: `${id}-help` }));
  box.append(element('p', '', { class: 'problem', id: `${id}-problem` }));
  return box;
}

// Up and down in a text change it by a step.
function nudge(event, key, input) {
  const direction = { ArrowUp: 1, ArrowDown: -1 }[event.key];
  const now = parse(key, input.value);
  if (!direction || now === null) return;
  event.preventDefault();
  const { kind, least, most, step } = key.kind;
  const by = { duration: step, length: 1000, rate: 1000, count: 1 }[kind] * direction;
  const lowest = kind === 'rate' ? -most : least;
  input.value = format(key, Math.min(Math.max(now + by, lowest), most));
  set(key.name, input.value, 'go on');
}

const UNITS = {
  duration: [['s', 1e9], ['ms', 1e6], ['us', 1e3], ['ns', 1]],
  length: [['m', 1e3], ['mm', 1]],
  rate: [['ppm', 1e3], ['ppb', 1]],
  count: [['', 1]],
};

function parse(key, words) {
  const found = /^([+-]?[\d.]+)\s*([a-zµ]*)$/.exec(words.trim());
  const unit = found && UNITS[key.kind.kind].find(([name]) => name === found[2].replace('µ', 'u'));
  return unit && isFinite(found[1]) ? Math.round(found[1] * unit[1]) : null;
}

function format(key, value) {
  const sign = key.kind.kind === 'rate' && value > 0 ? '+' : '';
  const units = UNITS[key.kind.kind];
  // The largest unit that keeps it short.
  const fits = units.find(([, size]) => Math.abs(value) >= size && (value * 1000 / size) % 1 === 0);
  const [name, size] = value === 0 ? units.at(key.kind.kind === 'duration' ? -1 : 0) : fits || units.at(-1);
  return `${sign}${+(value / size).toFixed(3)}${name}`;
}

// What a slider goes through: evenly, or as one would count up a range of many sizes.
function stopsOf(key) {
  const { kind, least, most } = key.kind;
  if (kind === 'count') {
    const step = most > 100 ? 50 : 1;
    return range_(Math.ceil(least / step), Math.floor(most / step)).map(n => String(Math.max(n * step, least)));
  }
  if (kind === 'rate') return range_(-20, 20).map(n => format(key, n * 5000));
  const stops = least === 0 ? [0] : [];
  for (let ten = kind === 'length' ? 100 : 10; ten <= most; ten *= 10)
    for (const times of [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8]) {
      const value = Math.round(ten * times);
      if (value >= least && value <= most) stops.push(value);
    }
  return stops.map(value => format(key, value));
}

function range_(from, to) { return Array.from({ length: to - from + 1 }, (_, i) => from + i); }

// Puts the state into the controls; not into the one that is being written in.
function fill(except) {
  const view = text('view') === 'pulses' ? 'pulses' : 'run';
  document.body.dataset.view = view;
  const mode = text('mode');
  for (const key of keys) {
    const control = $(`key-${key.name}`);
    const value = text(key.name);
    const box = control.closest('.field');
    const given = texts[key.name] !== undefined;
    let hidden = !key.views.includes(view);
    if (view === 'run' && key.name === 'sync1') hidden = !['dc-shift-sync1', 'dc-sync1'].includes(mode) && !given;
    if (view === 'run' && key.name === 'sync0-cycle') hidden = mode !== 'dc-subordinated' && !given;
    if (['phase', 'shift'].includes(key.name) && view === 'run') hidden = !mode.startsWith('dc') && !given;
    box.hidden = hidden;
    if (control !== except) control.value = value === 'own' ? '' : value;
    const slider = $(`key-${key.name}-slider`);
    if (slider) {
      const now = parse(key, value);
      const stops = stopsOf(key).map(stop => parse(key, stop));
      const near = now === null ? 0 : stops.reduce((best, stop, i) => Math.abs(stop - now) < Math.abs(stops[best] - now) ? i : best, 0);
      if (slider !== except) slider.value = near;
      slider.setAttribute('aria-valuetext', value === 'own' ? key.kind.own : value);
      slider.classList.toggle('own', value === 'own');
    }
  }
  const same = presets.find(preset => toHash(texts) === toHash(stateOf(preset)));
  $('preset').value = same ? same.id : '';
  $('preset-shows').textContent = same ? same.shows : '';
}

function stateOf(preset) {
  const found = {};
  for (const pair of preset.state.split('&')) {
    const [key, value] = pair.split('=');
    if (keyOf(key) && keyOf(key).default !== value) found[key] = value;
  }
  return found;
}

// ---- What comes back.

function work(extra = {}) {
  ask({ text: JSON.stringify({ ...texts, at: String(at), show: String(show), ...extra }), then: tell });
}

function verdict(words, kind) {
  const box = $('verdict');
  if (box.textContent !== words) box.textContent = words;
  $('verdict-box').className = kind;
}

function list(id, items) {
  $(id).replaceChildren(...items.map(item => element('li', item)));
}

// What went wrong on purpose: each leads to its cycle.
function incidents(faults) {
  $('incidents').replaceChildren(...faults.map(({ at: cycle, what }) => {
    const item = document.createElement('li');
    const button = element('button', what, { type: 'button' });
    button.addEventListener('click', async () => { stop(); await look(cycle); write('replace'); $('play').scrollIntoView(); });
    item.append(button);
    return item;
  }));
}

function tell(answer, took) {
  for (const problem of document.querySelectorAll('.field .problem')) problem.textContent = '';
  for (const control of document.querySelectorAll('[aria-invalid]')) control.removeAttribute('aria-invalid');
  const wrong = answer.problems.length > 0;
  $('result').classList.toggle('stale', wrong);
  list('problems', answer.problems.map(problem => problem.message));
  for (const { key, message } of answer.problems) {
    const control = $(`key-${key}`);
    if (!control) continue;
    control.setAttribute('aria-invalid', 'true');
    $(`key-${key}-problem`).textContent = message;
    control.closest('.field').hidden = false;
  }
  if (wrong) {
    stop();
    list('findings', []);
    incidents([]);
    $('took').textContent = '';
    return verdict(answer.problems.length === 1 ? 'One setting can\'t be:' : 'Some settings can\'t be:', 'bad');
  }
  verdict(answer.verdict, answer.good ? 'good' : 'bad');
  // What the verdict says already is not said again.
  incidents(answer.faults);
  list('findings', answer.findings.filter(finding => !answer.verdict.includes(finding)).slice(0, 8));
  $('took').textContent = `Simulated in ${Math.max(1, Math.round(took))} ms, here in the browser.`;
  draw(answer);
  rows('registers', answer.registers.map(row => [row.address, row.name, row.value]));
  rows('figures', answer.devices.map(device => [device.name, device.mode, device.state, device.sync0 || '–',
    bad(device.margin || '–', device.late), device.outputs || '–', ...device.counters.map(count => bad(count, Number(count) > 0))]));
  rows('plan', answer.devices.flatMap(device => device.plan.map(line =>
    [device.name, line.object, line.demand, line.times[0], line.times[1], bad(line.times[2], !line.fits)])));
  $('file').textContent = answer.file;
  const names = answer.devices.map(device => device.name);
  if ($('show').options.length !== names.length) $('show').replaceChildren(...names.map((name, i) => new Option(name, i)));
  $('show').value = String(Math.min(show, Math.max(names.length - 1, 0)));
}

const bad = (words, is) => ({ words, bad: is });

function rows(id, all) {
  const cell = value => {
    const made = element('td', value.words ?? value);
    if (value.bad) made.className = 'bad';
    return made;
  };
  $(id).tBodies[0].replaceChildren(...all.map(row => {
    const made = document.createElement('tr');
    made.append(...row.map(cell));
    return made;
  }));
}

const drawn = new Map();

function put(place, svgs) {
  const all = svgs.join('');
  if (drawn.get(place) === all) return;
  drawn.set(place, all);
  const old = $(place).querySelector('.wide-scroll')?.scrollLeft;
  $(place).innerHTML = all;
  // What moves while it plays is not zoomed: the next cycle would draw it anew.
  if (!['edges', 'counter', 'waves'].includes(place)) {
    for (const svg of $(place).querySelectorAll('svg.picture[data-from]')) new globalThis.isocatZoom.Zoom(svg);
  }
  const box = $(place).querySelector('.wide-scroll');
  // On a narrow screen it stays where it was looked at; the grid is in the middle.
  if (box) box.scrollLeft = old !== undefined ? old : place === 'edges' ? (box.scrollWidth - box.clientWidth) * 0.62 : 0;
}

function draw(answer, places = ['edges', 'counter', 'waves', 'cycle', 'miss', 'clock', 'sync0', 'pulses']) {
  for (const place of places) {
    const of = answer.pictures.filter(picture => picture.place === place);
    const heading = place !== 'pulses';
    put(place, of.map(picture => `<figure>${heading ? `<figcaption>${escape(picture.title)}</figcaption>` : ''}<div class="wide-scroll" tabindex="-1">${picture.svg}</div></figure>`));
  }
  if (answer.devices.length || places.length < 4) {
    [at, ...range] = answer.at;
    const slider = $('at');
    [slider.min, slider.max] = range;
    slider.value = at;
    const words = at < 0 ? `way up, ${-at} to go` : `cycle ${at}`;
    $('at-words').textContent = words;
    slider.setAttribute('aria-valuetext', words);
  }
}

const escape = words => words.replace(/[&<>"]/g, c => `&#${c.charCodeAt(0)};`);

// ---- Cycle by cycle.

function look(to) {
  at = Math.min(Math.max(to, range[0]), range[1]);
  return new Promise(done => {
    const question = JSON.stringify({ ...texts, at: String(at), show: String(show), only: 'play' });
    ask({ text: question, then: answer => { if (!answer.problems.length) draw(answer, ['edges', 'counter', 'waves']); done(); } });
  });
}

async function play() {
  if (document.body.dataset.view !== 'run') return;
  if (at >= range[1]) at = range[0];
  playing = true;
  $('toggle').textContent = 'Pause';
  $('toggle').setAttribute('aria-pressed', 'true');
  while (playing && at < range[1]) {
    const began = performance.now();
    await Promise.race([look(at + 1), pause(2000)]);
    // Who wants little motion gets one step in a second.
    await pause(Math.max(0, (calm.matches ? 1000 : 70) - (performance.now() - began)));
  }
  if (playing) { stop(); write('replace'); }
}

const pause = ms => new Promise(done => setTimeout(done, ms));

function stop() {
  playing = false;
  $('toggle').textContent = 'Play';
  $('toggle').setAttribute('aria-pressed', 'false');
}

function toggle() {
  if (!playing) return void play();
  stop();
  write('replace');
}

async function step(by) {
  stop();
  await look(at + by);
  write('replace');
}

$('toggle').addEventListener('click', toggle);
$('back').addEventListener('click', () => step(-1));
$('next').addEventListener('click', () => step(1));
$('at').addEventListener('input', () => { stop(); look(Number($('at').value)); });
$('at').addEventListener('change', () => write('replace'));
$('show').addEventListener('change', () => { show = Number($('show').value); write('push'); look(at); });

document.addEventListener('keydown', event => {
  const into = event.target.closest('input, select, textarea, button, summary, a');
  if (event.ctrlKey || event.altKey || event.metaKey || document.body.dataset.view !== 'run') return;
  if (event.key === 'Escape') $('tip').hidden = true;
  // In a control, keys are the control's; a slider has no use for those.
  if (into && into.type !== 'range') return;
  const keys = { ' ': toggle, ',': () => step(-1), '.': () => step(1) };
  if (!into) keys.Home = () => step(-1e9);
  if (!keys[event.key]) return;
  event.preventDefault();
  keys[event.key]();
});

// ---- Presets, link, colours.

$('preset').addEventListener('change', () => {
  const preset = presets.find(preset => preset.id === $('preset').value);
  texts = preset ? stateOf(preset) : texts;
  // Where there is something to see.
  [at, show] = [Number(/(?:^|&)at=(-?\d+)/.exec(preset?.state)?.[1] ?? 0), 0];
  write('push');
  fill();
  work();
});
$('reset').addEventListener('click', () => { texts = {}; at = show = 0; write('push'); fill(); work(); });
$('share').addEventListener('click', async () => {
  write('replace');
  try {
    await navigator.clipboard.writeText(location.href);
    $('shared').textContent = 'copied';
  } catch {
    $('shared').textContent = 'the link is in the address line';
  }
  setTimeout(() => { $('shared').textContent = ''; }, 3000);
});
for (const button of document.querySelectorAll('[data-to]'))
  button.addEventListener('click', () => { $(button.dataset.to).focus(); $(button.dataset.to).scrollIntoView(); });
$('controls').addEventListener('submit', event => event.preventDefault());

function colours(theme) {
  if (theme === 'auto') delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  $('theme').value = theme;
}
const remembered = () => { try { return localStorage.getItem('theme') || 'auto'; } catch { return 'auto'; } };
$('theme').addEventListener('change', () => {
  colours($('theme').value);
  try { localStorage.setItem('theme', $('theme').value); } catch { /* private window */ }
});
colours(remembered());

// ---- What is pointed at.

function tipOf(event) {
  const svg = event.target.closest('svg.picture');
  if (!svg) return null;
  for (let shape = event.target; shape !== svg; shape = shape.parentNode) {
    const title = shape.querySelector(':scope > title');
    // The browser would show it a second time.
    if (title) { shape.dataset.tip = title.textContent; title.remove(); }
    if (shape.dataset.tip) return shape.dataset.tip;
  }
  return svg.dataset.series ? seriesTip(svg, event) : null;
}

function seriesTip(svg, event) {
  const { left, width } = svg.getBoundingClientRect();
  const { from, to, left: begin, right: end } = svg.dataset;
  const units = (event.clientX - left) / width * svg.viewBox.baseVal.width;
  if (units < begin || units > end) return null;
  const ns = +from + (units - begin) / (end - begin) * (to - from);
  const spans = svg.dataset.series.split(' ').map(span => span.split(',').map(Number));
  const [first, last, least, mean, largest] = spans.reduce((best, span) => Math.abs((span[0] + span[1]) / 2 - ns) < Math.abs((best[0] + best[1]) / 2 - ns) ? span : best);
  const when = first === last ? `at ${first / 1e6} ms` : `${first / 1e6} to ${last / 1e6} ms`;
  return least === largest ? `${when}: ${mean} ns` : `${when}: mean ${mean} ns, from ${least} to ${largest} ns`;
}

function point(event) {
  const tip = $('tip');
  const words = event.target instanceof Element ? tipOf(event) : null;
  tip.hidden = !words;
  if (!words) return;
  tip.textContent = words;
  const { offsetWidth: width, offsetHeight: height } = tip;
  const left = Math.min(event.clientX + 14, innerWidth - width - 8);
  const top = event.clientY + 18 + height > innerHeight ? event.clientY - height - 12 : event.clientY + 18;
  tip.style.left = `${Math.max(4, left)}px`;
  tip.style.top = `${Math.max(4, top)}px`;
}
document.addEventListener('pointermove', point);
document.addEventListener('pointerdown', point);
document.addEventListener('scroll', () => { $('tip').hidden = true; }, true);

// ---- Begin.

addEventListener('popstate', load);
ask({
  text: '',
  then: answer => {
    ({ keys, presets } = answer);
    $('pictures').textContent = answer.style;
    const script = document.createElement('script');
    script.textContent = answer.zoom;
    document.head.append(script);
    build();
    load();
    document.body.classList.add('ready');
  },
});
