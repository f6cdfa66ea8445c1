// Opens the reports in a browser as people do. Arguments: the folder with the pages, and one for pictures, or nothing.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { chromium } from "playwright-core";

const [, , folder, pictures] = process.argv;
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });
const wrong = [];

async function open(name, width, colorScheme) {
  const page = await browser.newPage({ viewport: { width, height: 900 }, colorScheme });
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && wrong.push(`${name}: ${message.text()}`));
  page.on("pageerror", (error) => wrong.push(`${name}: ${error.message}`));
  page.on("request", (request) => /^(file|data|blob):/.test(request.url()) || wrong.push(`${name} asks for ${request.url()}`));
  await page.goto(`file://${folder}/${name}.html`);
  return page;
}

/** The first line of what the command said is the verdict of the page. */
const verdict = (name) => readFileSync(`${folder}/${name}.txt`, "utf8").split("\n\n")[0].split(/\n(?=\S+: cycle|built-in)/)[0].replaceAll("\n", " ");

for (const name of ["run", "late", "plan", "conform", "sweep"]) {
  for (const [width, scheme] of [[1200, "light"], [390, "dark"]]) {
    const page = await open(name, width, scheme);
    const words = await page.textContent("h1");
    if (!["conform", "sweep"].includes(name)) assert.ok(verdict(name).startsWith(words.trim()), `${name}: ${words} / ${verdict(name)}`);
    assert.ok(words.length > 10);
    const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
    assert.ok(over <= 0, `${name} at ${width}: ${over} pixels too wide`);
    const paper = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
    assert.equal(paper, scheme === "dark" ? "rgb(18, 22, 29)" : "rgb(255, 255, 255)");
    if (pictures) await page.screenshot({ path: `${pictures}/${name}-${width}-${scheme}.png`, fullPage: true });
    await page.close();
  }
}

// Pointing at an event tells its figures in ns.
const page = await open("run", 1200, "light");
const cycle = page.locator("#cycles svg[data-from]").first();
await cycle.scrollIntoViewIfNeeded();
// A stroke has no width, so it is met by its place.
const stroke = await cycle.locator("g.mark[data-tip^='SYNC0']").first().evaluate((mark) => {
  const { left, width, top, height } = mark.getBoundingClientRect();
  return [left + width / 2, top + height * 0.8];
});
await page.mouse.move(...stroke);
let tip = await page.textContent("#tip");
assert.match(tip, /planned from [\d.]+ ns to [\d.]+ ns/);
assert.match(tip, /seen \d+ times in true time: mean [\d.]+ ns/);
assert.ok(await page.locator("#tip").isVisible());

// Zoom by button, by drawing, by key; the whole again. What is seen is always in the axis's words.
const ticks = () => cycle.locator("text.tick").allTextContents();
const before = await ticks();
await page.locator("#cycles figure:has(svg[data-from])").first().getByRole("button", { name: "zoom in" }).click();
assert.notDeepEqual(await ticks(), before, "the button zooms");
await cycle.dblclick();
assert.equal((await ticks()).at(0), before.at(0));
const box = await cycle.boundingBox();
await page.mouse.move(box.x + box.width * 0.5, box.y + 40);
await page.mouse.down();
await page.mouse.move(box.x + box.width * 0.6, box.y + 40, { steps: 4 });
await page.mouse.up();
const range = await ticks();
assert.ok(range.length >= 3 && range.every((tick) => /us$/.test(tick)), `drawing zooms: ${range}`);
await cycle.focus();
for (let i = 0; i < 16; i += 1) await page.keyboard.press("+");
const deep = await ticks();
assert.ok(deep.some((tick) => /\.\d{3} us$/.test(tick)) || deep.every((tick) => /ns$/.test(tick)), `to the nanosecond: ${deep}`);
await page.keyboard.press("0");
await page.keyboard.press("n");
assert.ok((await page.textContent("#tip")).includes(" ns"), "keys reach the figures");
await page.keyboard.press("Escape");

// A curve tells its values, an axis its instants.
const series = page.locator("svg[data-series]").first();
await series.scrollIntoViewIfNeeded();
const place = await series.boundingBox();
await page.mouse.move(place.x + place.width * 0.5, place.y + place.height * 0.3);
tip = await page.textContent("#tip");
assert.match(tip, /mean -?[\d.\u202f]+ ns, from -?[\d.\u202f]+ ns to -?[\d.\u202f]+ ns/);

// A SubDevice can be hidden and shown.
const article = page.locator("article#device-1");
assert.ok(await article.isVisible());
await page.locator("input[data-hides='1']").uncheck();
assert.ok(!(await article.isVisible()), "hidden");
await page.locator("input[data-hides='1']").check();
assert.ok(await article.isVisible(), "shown");
await page.locator("input[data-hides='1']").uncheck();
await page.locator("a[href='#device-1']").first().click();
assert.ok(await article.isVisible(), "who goes there sees it");

// Light and dark by hand.
const paper = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
await page.locator("#theme").click();
await page.locator("#theme").click();
assert.equal(await paper(), "rgb(18, 22, 29)", "dark by hand");

// The report for programs comes out again.
const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#save").click()]);
const report = JSON.parse(readFileSync(await download.path(), "utf8"));
assert.equal(report.in_sync, true);

// On paper: light whatever the screen is, and nothing but what is to be read.
const pdf = await page.pdf({ format: "A4", path: pictures ? `${pictures}/run.pdf` : undefined });
assert.ok(pdf.length > 20000 && pdf.subarray(0, 5).toString() === "%PDF-");
await page.emulateMedia({ media: "print" });
assert.equal(await paper(), "rgb(255, 255, 255)", "paper is white");
const ink = await page.locator("svg.picture text.name").first().evaluate((text) => getComputedStyle(text).fill);
assert.equal(ink, "rgb(0, 0, 0)", "drawings are dark on it");
assert.ok(!(await page.locator(".tools").first().isVisible()), "no buttons on paper");
await page.close();

// All devices on one axis: the tightest first, equal ones in one row and in one drawing, colours by the lateness of the host.
const many = await open("many", 1200, "light");
const names = await many.locator("#all text.name").allTextContents();
assert.deepEqual(names, ["frames", "1 late", "2 axis", "3 to 14 io 0..11"], "rows");
assert.deepEqual(await many.locator("#cycles article").evaluateAll((all) => all.map((one) => one.id)), ["device-1", "device-2", "device-3", "device-0"]);
assert.equal(await many.locator("#all rect.left.bad").count(), 1);
const words_at = (class_, text) => many.locator(`#all text.${class_}`, { hasText: text }).first().getAttribute("x");
assert.ok(Number(await words_at("bad", "outputs too late by")) > 190, "it is said in words");
const texts = await many.locator("#all text.moves").evaluateAll((all) => all.map((text) => text.getBoundingClientRect().toJSON()));
for (const [i, a] of texts.entries()) {
  for (const b of texts.slice(i + 1)) {
    assert.ok(a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top, "words do not lie on each other");
  }
}
if (pictures) await many.locator("#all").screenshot({ path: `${pictures}/all-devices.png` });
await many.close();

// What is wrong stands first, with its cause and its remedy.
const late = await open("late", 1200, "light");
const why = await late.textContent("#why");
for (const words of ["SubDevice 1 (gripper)", "after the SYNC0", "0x1C32:06 states 20 us", "0x1C32:06 = 178000 ns", "stayed in OP"]) {
  assert.ok(why.includes(words), `${words}: ${why}`);
}
const first = await late.locator("article[id^='device-']").first().getAttribute("id");
assert.equal(first, "device-1", "the device with the trouble is drawn first");
await late.close();

// Without its script a page shows all the same.
const bare = await browser.newContext({ javaScriptEnabled: false });
const plain = await bare.newPage();
await plain.goto(`file://${folder}/late.html`);
assert.ok(await plain.locator("#why").isVisible() && await plain.locator("svg").first().isVisible());
await browser.close();
assert.deepEqual(wrong, [], "nothing is complained of");
console.log("ok: verdicts, figures at the pointer, zoom, hiding, dark mode, paper, JSON, without script");
