// The page of `larix report` in headless Chromium: opened from the disk without a network, no
// message in the console, every plot of report.json drawn, nothing wider than the window at 1280
// and 400 pixels and on paper. Exit code 1, with each fault on a line, if any does not hold.
//
//     node tools/check_report.mjs REPORT_FOLDER [PICTURE_FOLDER]
//     node tools/check_report.mjs --self-test REPORT_FOLDER    seeded defects must be caught
//
// Modules are looked for in $LARIX_NODE_MODULES, else beside this file.

import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { createRequire } from 'node:module';
import { fileURLToPath, pathToFileURL } from 'node:url';

const here = path.dirname(fileURLToPath(import.meta.url));
const modules = path.resolve(process.env.LARIX_NODE_MODULES || path.join(here, 'node_modules'));
const require = createRequire(path.join(modules, 'anything.js'));
const { chromium } = (await import(pathToFileURL(require.resolve('playwright-core')).href)).default;

// Ids of the plots that a document asks for.
function plots(document) {
  const fronts = document.fronts.flatMap(f => (f.cost ? [f.id, `${f.id}-cost`] : [f.id]));
  const scales = document.scale.flatMap(s => [s.id, `${s.id}-memory`]);
  return [...fronts, ...document.convergence.map(l => l.id), ...scales];
}

// In the page: what is missing, empty or too wide.
function look(ids) {
  const faults = [];
  for (const id of ids) {
    const svg = document.querySelector(`#plot-${CSS.escape(id)} svg`);
    if (!svg) { faults.push(`no plot ${id}`); continue; }
    const box = svg.getBoundingClientRect();
    if (box.width < 200 || box.height < 100) faults.push(`plot ${id} is ${box.width} × ${box.height}`);
    if (svg.querySelectorAll('circle, polygon, rect, path, polyline').length < 3) faults.push(`plot ${id} is empty`);
  }
  const wide = document.documentElement.scrollWidth, window_ = document.documentElement.clientWidth;
  if (wide > window_) faults.push(`the page is ${wide} wide in a window of ${window_}`);
  for (const element of document.querySelectorAll('body *')) {
    if (element.closest('.table table') || element.closest('svg') !== null && element.tagName !== 'svg') continue;
    const right = element.getBoundingClientRect().right;
    if (right > window_ + 1) faults.push(`<${element.tagName.toLowerCase()}> ends at ${right} in a window of ${window_}`);
  }
  const misses = document.querySelectorAll('tr.miss, p.miss').length;
  return { faults, misses, rows: document.querySelectorAll('tbody tr').length };
}

async function check(browser, folder, pictures) {
  const document = JSON.parse(fs.readFileSync(path.join(folder, 'report.json')));
  const ids = plots(document);
  const faults = [];
  for (const id of ids) {
    if (!fs.existsSync(path.join(folder, 'plots', `${id}.svg`))) faults.push(`no file plots/${id}.svg`);
  }
  const context = await browser.newContext({ offline: true });
  let found;
  for (const width of [1280, 400]) {
    const page = await context.newPage();
    await page.setViewportSize({ width, height: 900 });
    page.on('console', message => faults.push(`console: ${message.text()}`));
    page.on('pageerror', error => faults.push(`error: ${error}`));
    page.on('request', request => { if (!/^(file|data):/.test(request.url())) faults.push(`asks for ${request.url()}`); });
    await page.goto(pathToFileURL(path.resolve(folder, 'report.html')).href);
    found = await page.evaluate(look, ids);
    faults.push(...found.faults.map(fault => `${width} px: ${fault}`));
    if (pictures) await page.screenshot({ path: path.join(pictures, `report-${width}.png`), fullPage: true });
    if (width === 1280 && pictures) {
      await page.pdf({ path: path.join(pictures, 'report.pdf'), format: 'A4' });
    }
    await page.close();
  }
  await context.close();
  const red = document.stability.filter(f => !f.passes).length
    + document.convergence.filter(l => !l.converges).length
    + document.left_out.flatMap(o => o.rows).filter(r => !r.is_proved).length;
  if (found.misses !== red) faults.push(`${found.misses} misses shown, ${red} in report.json`);
  return { faults, told: `${ids.length} plots, ${found.rows} rows, ${red} misses` };
}

// Each change must be seen as a fault that says so.
const DEFECTS = [
  ['too wide', page => page.replace('<h1>', '<h1 style="width:3000px">'), /wide|ends at/],
  ['a plot gone', page => page.replace(/<figure id="plot-terrain">.*?<\/figure>/s, ''), /no plot terrain/],
  ['a script that fails', page => page.replace('</body>', '<script>throw new Error("seeded")</script></body>'), /seeded/],
  ['a font from elsewhere', page => page.replace('</head>', '<link rel="stylesheet" href="https://example.org/x.css"></head>'), /asks for|console/],
  ['a miss not shown', page => page.replace('<tbody>', '<tbody><tr class="miss"><td>x</td></tr>'), /misses shown/],
];

async function selfTest(browser, folder) {
  const faults = [];
  for (const [name, change, expected] of DEFECTS) {
    const copy = fs.mkdtempSync(path.join(os.tmpdir(), 'report-'));
    fs.cpSync(folder, copy, { recursive: true });
    const file = path.join(copy, 'report.html');
    const page = fs.readFileSync(file, 'utf8');
    const changed = change(page);
    if (changed === page) faults.push(`${name}: could not be seeded`);
    fs.writeFileSync(file, changed);
    const { faults: seen } = await check(browser, copy);
    if (!seen.some(fault => expected.test(fault))) faults.push(`${name}: not seen, but ${JSON.stringify(seen)}`);
    fs.rmSync(copy, { recursive: true });
  }
  return { faults, told: `${DEFECTS.length} seeded defects caught` };
}

const browser = await chromium.launch({
  executablePath: process.env.LARIX_CHROMIUM || '/usr/bin/chromium',
  args: ['--no-sandbox', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
try {
  const [first, second] = process.argv.slice(2);
  const { faults, told } = first === '--self-test' ? await selfTest(browser, second) : await check(browser, first, second);
  for (const fault of faults) console.log(`FAIL ${fault}`);
  console.log(faults.length ? `${faults.length} faults` : `good: ${told}`);
  process.exitCode = faults.length ? 1 : 0;
} finally {
  await browser.close();
}
