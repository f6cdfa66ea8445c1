// Uses the playground as people do, in a headless browser. Arguments: address, browser, folder for pictures (may be empty).
import assert from 'node:assert/strict';
import { chromium } from 'playwright-core';

const [address, executablePath, shots] = process.argv.slice(2);
const browser = await chromium.launch({ executablePath, args: ['--no-sandbox'] });
let checks = 0;

async function open(hash = '', options = {}) {
  const context = await browser.newContext({ viewport: { width: 1400, height: 1000 }, ...options });
  const page = await context.newPage();
  page.wrong = [];
  page.on('console', message => { if (message.type() === 'error') page.wrong.push(message.text()); });
  page.on('pageerror', error => page.wrong.push(error.message));
  await page.goto(address + hash);
  await done(page);
  return page;
}

// The answer is there, and no other question is under way.
async function done(page) {
  await page.waitForTimeout(150);
  await page.waitForFunction(() => document.body.classList.contains('ready') && !document.body.classList.contains('busy')
    && !document.getElementById('verdict').textContent.startsWith('Loading'), null, { timeout: 60000 });
}

async function check(name, what) {
  const pages = [];
  await what(async (...given) => { const page = await open(...given); pages.push(page); return page; });
  for (const page of pages) {
    assert.deepEqual(page.wrong, [], `${name}: errors in the console`);
    await page.context().close();
  }
  checks += 1;
  console.log(`ok  ${name}`);
}

// Lines have no area that a browser would scroll to by itself.
async function pointAt(page, selector) {
  const [x, y] = await page.$eval(selector, shape => {
    shape.scrollIntoView({ block: 'center' });
    const { x, y, width, height } = shape.getBoundingClientRect();
    return [x + width / 2, y + height / 2];
  });
  await page.mouse.move(x + 1, y);
  await page.mouse.move(x, y);
}

const verdict = page => page.textContent('#verdict');
const hash = page => page.evaluate(() => decodeURIComponent(location.hash));
const svg = (page, place) => page.$eval(`#${place}`, box => box.innerHTML);

await check('a cycle can be zoomed, by button, mouse and key, and printed', async open => {
  const page = await open();
  const cycle = page.locator('#cycle svg').first();
  const ticks = () => cycle.locator('text.tick').allTextContents();
  const whole = await ticks();
  await page.locator('#cycle figure').first().getByRole('button', { name: 'zoom in' }).click();
  assert.notDeepEqual(await ticks(), whole, 'the button zooms');
  await cycle.dblclick();
  await cycle.scrollIntoViewIfNeeded();
  const box = await cycle.boundingBox();
  await page.mouse.move(box.x + box.width * 0.5, box.y + 20);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.6, box.y + 20, { steps: 4 });
  await page.mouse.up();
  assert.ok((await ticks()).every(tick => tick.endsWith('us')), 'drawing a part zooms into it');
  const before = await hash(page);
  await cycle.focus();
  await page.keyboard.press('ArrowRight');
  await page.keyboard.press('0');
  assert.equal(await hash(page), before, 'keys of a picture are its own');
  assert.ok((await page.pdf({ format: 'A4' })).length > 20000, 'it can be printed');
});

await check('the first look: in sync, pictures, figures', async open => {
  const page = await open();
  assert.match(await verdict(page), /^In sync: 3 of 3/);
  for (const place of ['edges', 'waves', 'cycle']) assert.match(await svg(page, place), /<svg/);
  assert.equal(await page.locator('#cycle svg').count(), 3);
  assert.equal(await page.locator('#figures tbody tr').count(), 3);
  assert.match(await page.textContent('#file'), /\[\[subdevice\]\]/);
});

await check('a control changes picture and address; back and forward restore', async open => {
  const page = await open();
  const before = await svg(page, 'cycle');
  await page.selectOption('#key-mode', 'dc-shift-sync1');
  await done(page);
  assert.match(await hash(page), /mode=dc-shift-sync1/);
  assert.notEqual(await svg(page, 'cycle'), before);
  await page.fill('#key-sync1', '300us');
  await page.press('#key-sync1', 'Enter');
  await done(page);
  assert.match(await hash(page), /sync1=300us/);
  await page.goBack();
  await page.goBack();
  await done(page);
  assert.equal(await page.inputValue('#key-mode'), 'dc-sync0');
  assert.equal(await svg(page, 'cycle'), before);
  await page.goForward();
  await done(page);
  assert.equal(await page.inputValue('#key-mode'), 'dc-shift-sync1');
});

await check('the address restores the state', async open => {
  const page = await open('#mode=sm&cycle=2ms&devices=2&host-jitter=100us&clocks=+30ppm');
  assert.equal(await page.inputValue('#key-mode'), 'sm');
  assert.equal(await page.inputValue('#key-cycle'), '2ms');
  assert.equal(await page.inputValue('#key-clocks'), '+30ppm');
  assert.match(await verdict(page), /^In sync: 2 of 2/);
});

await check('bad values are named, with what is expected', async open => {
  const page = await open('#cycle=1lightyear&mod=sm&devices=99');
  const problems = await page.textContent('#problems');
  assert.match(problems, /cycle: .*1lightyear.*expected.*ns, us, ms/);
  assert.match(problems, /unknown key "mod".*mode/);
  assert.match(problems, /devices = 99; expected 1 to 8/);
  assert.equal(await page.getAttribute('#key-cycle', 'aria-invalid'), 'true');
  await page.fill('#key-cycle', '1ms');
  await page.fill('#key-devices', '2');
  await done(page);
  // The second value is taken a moment after the first one.
  await page.waitForFunction(() => document.querySelector('#problems').textContent === '');
  await done(page);
  assert.match(await verdict(page), /^In sync: 2 of 2/);
});

await check('the last nanosecond: the counter begins to count', async open => {
  const page = await open('#devices=2&clocks=0ppm&host-clock=0ppm&host-jitter=0ns&phase=300us&copy-time=292670ns');
  assert.match(await verdict(page), /^In sync/);
  assert.equal(await page.locator('#counter svg').count(), 0);
  await page.focus('#key-copy-time');
  await page.keyboard.press('ArrowUp');
  await done(page);
  assert.match(await hash(page), /copy-time=292\.671us/);
  assert.match(await verdict(page), /^Not in sync/);
  assert.equal(await page.locator('#counter svg').count(), 1);
  assert.equal(await page.locator('#miss svg').count(), 1);
});

await check('a fault is written, refused in the words of its parser, seen in its cycle', async open => {
  const page = await open('#cycles=900&recovery=again');
  assert.match(await verdict(page), /^In sync/);
  await page.fill('#key-faults', 'in-operation + 50ms: pul 1');
  await done(page);
  assert.match(await page.textContent('#key-faults-problem'), /pul/);
  assert.equal(await page.getAttribute('#key-faults', 'aria-invalid'), 'true');
  await page.fill('#key-faults', 'in-operation + 50ms: pull 1 for 20ms\ncycle 3: drop 1');
  await done(page);
  assert.equal(await page.textContent('#problems'), '');
  assert.match(await verdict(page), /^Not in sync: SubDevice 1/);
  assert.match(await hash(page), /faults=in-operation \+ 50ms: pull/);
  const before = await svg(page, 'waves');
  await page.getByRole('button', { name: /cable to SubDevice 1 is pulled/ }).first().click();
  await done(page);
  assert.equal(await page.textContent('#at-words'), 'cycle 50');
  assert.notEqual(await svg(page, 'waves'), before);
  assert.match(await page.textContent('#file'), /\[\[fault\]\]/);
  await page.reload();
  await done(page);
  assert.match(await page.inputValue('#key-faults'), /for 20ms\ncycle 3: drop 1$/);
  assert.match(await verdict(page), /^Not in sync: SubDevice 1/);
});

await check('who points at something is told its nanoseconds', async open => {
  const page = await open();
  await pointAt(page, '#cycle svg rect[class="outputs"]');
  assert.match(await page.textContent('#tip'), /calc and copy of outputs[^]*\d ns/);
  await pointAt(page, '#edges line[class="m pulse"] + .grip');
  assert.match(await page.textContent('#tip'), /SYNC0 .* ns off/);
});

await check('the keyboard alone: another mode, play, pause, step', async open => {
  const page = await open();
  for (let i = 0; i < 12; i += 1) {
    if (await page.evaluate(() => document.activeElement.id === 'key-mode')) break;
    await page.keyboard.press('Tab');
  }
  assert.equal(await page.evaluate(() => document.activeElement.id), 'key-mode');
  await page.keyboard.press('ArrowUp');
  await done(page);
  assert.match(await hash(page), /mode=sm/);
  await page.keyboard.press('ArrowDown');
  await done(page);
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press('Home');
  await done(page);
  const first = await page.textContent('#at-words');
  assert.match(first, /way up/);
  await page.keyboard.press(' ');
  await page.waitForFunction(words => document.getElementById('at-words').textContent !== words, first, { timeout: 20000 });
  await page.keyboard.press(' ');
  await done(page);
  const stopped = await page.textContent('#at-words');
  await page.keyboard.press('.');
  await done(page);
  assert.notEqual(await page.textContent('#at-words'), stopped);
  assert.match(await hash(page), /at=-?\d+/);
  const slider = page.locator('#key-cycle-slider');
  await slider.focus();
  await page.keyboard.press('ArrowRight');
  await done(page);
  assert.match(await hash(page), /cycle=1\.2ms/);
});

await check('every preset shows something without an error', async open => {
  const page = await open();
  const presets = await page.$$eval('#preset option', options => options.map(option => option.value).filter(Boolean));
  assert.ok(presets.length >= 14, `${presets.length} presets`);
  for (const preset of presets) {
    await page.selectOption('#preset', preset);
    await done(page);
    assert.equal(await page.textContent('#problems'), '', preset);
    assert.ok(await page.locator('svg.picture:visible').count() > 0, preset);
    assert.notEqual(await page.textContent('#preset-shows'), '', preset);
  }
});

await check('dark and light, by the system and by hand', async open => {
  const ground = page => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const dark = await open('', { colorScheme: 'dark' });
  const light = await open('', { colorScheme: 'light' });
  assert.notEqual(await ground(dark), await ground(light));
  await light.selectOption('#theme', 'dark');
  assert.equal(await ground(light), await ground(dark));
  const ink = page => page.$eval('#cycle svg text.name', text => getComputedStyle(text).fill);
  assert.equal(await ink(light), await ink(dark), 'pictures follow');
});

await check('a phone needs no scrolling sideways', async open => {
  for (const state of ['', '#view=pulses&sync1=250us', '#cycle=nonsense', '#devices=2&phase=300us&copy-time=276us&force=on&host-jitter=40us']) {
    const page = await open(state, { viewport: { width: 390, height: 844 } });
    const [width, inner] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
    assert.ok(width <= inner, `${state}: ${width} of ${inner}`);
  }
});

await check('who wants little motion gets one step in a second', async open => {
  const page = await open('', { reducedMotion: 'reduce' });
  await page.click('#toggle');
  await page.waitForTimeout(2500);
  await page.click('#toggle');
  await done(page);
  const at = Number((await page.textContent('#at-words')).replace(/\D+/, ''));
  assert.ok(at >= 1 && at <= 4, `${at} steps in 2.5 s`);
});

if (shots) {
  const states = { run: '', shift: '#mode=dc-shift-sync1&sync1=250us&at=-60', slack: '#devices=2&phase=300us&copy-time=276us&force=on&host-jitter=40us&at=40', pulses: '#view=pulses&sync1=250us', bad: '#cycle=1lightyear&mod=sm', cut: '#recovery=again&cycles=1500&faults=in-operation%20+%2050ms:%20pull%201%20for%2020ms&at=52&show=1' };
  for (const [name, state] of Object.entries(states))
    for (const colorScheme of ['light', 'dark'])
      for (const [size, width] of [['desk', 1400], ['phone', 390]]) {
        const page = await open(state, { colorScheme, viewport: { width, height: 900 } });
        await page.screenshot({ path: `${shots}/${name}-${size}-${colorScheme}.png`, fullPage: true });
        await page.context().close();
      }
}
await browser.close();
console.log(`playground in a browser: ${checks} checks passed`);
