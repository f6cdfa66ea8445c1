// Draws the panels of grafana-dashboard.json with figures of a Prometheus, in a headless browser: none is empty, nothing is
// complained of. Arguments: the browser, the address of Prometheus.
import { createServer } from "node:http";
import { readFileSync } from "node:fs";
import { chromium } from "playwright-core";

const [executablePath, prometheus] = process.argv.slice(2);
const files = { "/": ["dashboard.html", "text/html"], "/dashboard.json": ["grafana-dashboard.json", "application/json"] };
const server = createServer((request, response) => {
  const [file, type] = files[request.url] ?? [];
  response.writeHead(file ? 200 : 404, { "content-type": type ?? "text/plain" });
  response.end(file ? readFileSync(file) : "");
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1400, height: 1800 } });
const complaints = [];
page.on("console", (message) => { if (message.type() === "error") complaints.push(message.text()); });
page.on("pageerror", (error) => complaints.push(String(error)));
await page.goto(`http://127.0.0.1:${server.address().port}/`);
const panels = await page.evaluate(async (prometheus) => {
  const dashboard = await (await fetch("/dashboard.json")).json();
  return await draw(prometheus, dashboard);
}, prometheus);
await page.screenshot({ path: "dashboard.png", fullPage: true });
await browser.close();
server.close();
const expected = JSON.parse(readFileSync("grafana-dashboard.json")).panels.length;
const empty = panels.filter(({ series, title, text }) => series === 0 || !text.includes(title) || /NaN|undefined|Infinity/.test(text));
if (complaints.length || empty.length || panels.length !== expected) {
  console.error({ complaints, empty, drawn: panels.length, expected });
  process.exit(1);
}
console.log(`ok: ${panels.length} panels drawn in a browser, none empty, no complaint`);
