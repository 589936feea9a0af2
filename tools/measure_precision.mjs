// What numbers of fewer bits cost and save: trees written in every glTF profile, compared vertex by
// vertex with `dcc`, and positions counted in fewer and fewer bits. Prints two tables.
//
//     node tools/measure_precision.mjs LARIX FOLDER
//
// LARIX is the program, FOLDER takes its files. Modules are looked for as in readers.mjs. A vertex of
// `web`, whose order is its own, is compared with the likest of those within 3 mm in `dcc`.

import { spawnSync } from 'node:child_process';
import path from 'node:path';
import { createRequire } from 'node:module';
import { fileURLToPath, pathToFileURL } from 'node:url';

const here = path.dirname(fileURLToPath(import.meta.url));
const modules = path.resolve(process.env.LARIX_NODE_MODULES || path.join(here, 'node_modules'));
const require = createRequire(path.join(modules, 'anything.js'));
const load = name => import(pathToFileURL(require.resolve(name)).href);
const { Logger, NodeIO, Verbosity } = await load('@gltf-transform/core');
const { ALL_EXTENSIONS } = await load('@gltf-transform/extensions');
const { MeshoptDecoder, MeshoptEncoder } = await load('meshoptimizer');
await Promise.all([MeshoptDecoder.ready, MeshoptEncoder.ready]);

const SPECIES = ['larix_sibirica', 'betula_pendula', 'pinus_sylvestris', 'picea_obovata'];
const TRIANGLES = 20000;
const NEAR_M = 0.003;
const [larix, folder] = process.argv.slice(2);

function written(species, profile) {
  const file = path.join(folder, `${species}_${profile}.glb`);
  const plain = profile === 'engine' ? ['--lods', '0', '--wind', 'none', '--collision', 'none', '--impostor', 'none'] : [];
  const run = spawnSync(larix, ['tree', species, '--triangles', TRIANGLES, '--profile', profile, ...plain, '-o', file, '--quiet']);
  if (run.status) throw new Error(run.stderr.toString());
  return file;
}

// Vertices of the finest form by material, placed and with what textures are shifted by; bytes of all
// but pictures.
async function read(file) {
  const io = new NodeIO().setLogger(new Logger(Verbosity.SILENT)).registerExtensions(ALL_EXTENSIONS).registerDependencies({ 'meshopt.decoder': MeshoptDecoder });
  const { json } = await io.readAsJSON(file);
  const pictures = new Set((json.images ?? []).map(image => image.bufferView));
  const bytes = json.bufferViews
    .filter((_, k) => !pictures.has(k))
    .reduce((sum, view) => sum + (view.extensions?.EXT_meshopt_compression ?? view).byteLength, 0);
  const root = (await io.read(file)).getRoot();
  const parts = new Map();
  root.listScenes()[0].traverse(node => {
    const placed = node.getExtension('EXT_mesh_gpu_instancing');
    const first = name => placed?.getAttribute(name)?.getElement(0, []);
    const scale = first('SCALE') ?? [1, 1, 1];
    for (const p of node.getMesh()?.listPrimitives() ?? []) {
      const material = p.getMaterial();
      const shift = material.getBaseColorTextureInfo()?.getExtension('KHR_texture_transform');
      const [uo, us] = [shift?.getOffset() ?? [0, 0], shift?.getScale() ?? [1, 1]];
      const size = material.getBaseColorTexture().getSize();
      const column = name => p.getAttribute(name);
      const vertices = [];
      for (let k = 0; k < column('POSITION').getCount(); k += 1) {
        const at = column('POSITION').getElement(k, []).map((x, axis) => x * scale[axis]);
        const uv = column('TEXCOORD_0').getElement(k, []).map((x, axis) => (x * us[axis] + uo[axis]) * size[axis]);
        vertices.push({ at, normal: column('NORMAL').getElement(k, []), uv });
      }
      parts.set(material.getName(), { vertices, index: p.getIndices().getArray() });
    }
  });
  return { bytes, parts };
}

const distance = (a, b) => Math.hypot(...a.map((x, k) => x - b[k]));
function degrees(a, b) {
  const [na, nb] = [Math.hypot(...a), Math.hypot(...b)];
  const half = distance(a.map(x => x / na), b.map(x => x / nb)) / 2;
  return 2 * Math.asin(Math.min(half, 1)) * 180 / Math.PI;
}
const apart = (a, b) => ({ mm: 1000 * distance(a.at, b.at), degrees: degrees(a.normal, b.normal), texels: distance(a.uv, b.uv) });

function* likest(vertices, among) {
  const cell = at => at.map(x => Math.floor(x / NEAR_M));
  const cells = new Map();
  for (const vertex of among) {
    const key = cell(vertex.at).join();
    if (!cells.has(key)) cells.set(key, []);
    cells.get(key).push(vertex);
  }
  for (const vertex of vertices) {
    const [x, y, z] = cell(vertex.at);
    let best;
    for (let k = 0; k < 27; k += 1) {
      const key = [x + k % 3 - 1, y + Math.floor(k / 3) % 3 - 1, z + Math.floor(k / 9) - 1].join();
      for (const other of cells.get(key) ?? []) {
        const found = apart(vertex, other);
        found.sum = found.mm + found.degrees + found.texels;
        if (!best || found.sum < best.sum) best = found;
      }
    }
    if (!best) throw new Error(`nothing within ${NEAR_M} m of ${vertex.at}`);
    yield best;
  }
}

function errors(one, exact, inOrder) {
  const worst = { mm: 0, degrees: 0, texels: 0 }, squares = { mm: 0, degrees: 0, texels: 0 };
  let count = 0;
  for (const [name, { vertices }] of one.parts) {
    const among = exact.parts.get(name).vertices;
    const pairs = inOrder ? vertices.map((v, k) => apart(v, among[k])) : likest(vertices, among);
    for (const found of pairs) {
      count += 1;
      for (const key of Object.keys(worst)) {
        worst[key] = Math.max(worst[key], found[key]);
        squares[key] += found[key] ** 2;
      }
    }
  }
  const both = key => `${worst[key].toFixed(3)} / ${Math.sqrt(squares[key] / count).toFixed(3)}`;
  return [both('mm'), both('degrees'), both('texels')];
}

const row = cells => console.log(`| ${cells.join(' | ')} |`);
const kilo = bytes => (bytes / 1000).toFixed(0);

row(['tree of 20,000 triangles', 'profile', 'geometry kB', 'of `dcc`', 'positions mm, worst / RMS', 'normals °', 'textures, texels']);
row(['---', '---', '---:', '---:', '---:', '---:', '---:']);
let larch;
for (const species of SPECIES) {
  const dcc = await read(written(species, 'dcc'));
  larch ??= dcc;
  row([species, 'dcc', kilo(dcc.bytes), '', '0', '0', '0']);
  for (const profile of ['engine', 'web']) {
    const one = await read(written(species, profile));
    const share = `${(100 * one.bytes / dcc.bytes).toFixed(0)} %`;
    row([species, profile, kilo(one.bytes), share, ...errors(one, dcc, profile === 'engine')]);
  }
}

// As `web` codes them: counted from the root in a cube that holds the tree, ordered and compressed.
console.log();
row(['bits of a position', 'worst mm', 'RMS mm', 'kB of positions', 'of 32 bits']);
row(['---:', '---:', '---:', '---:', '---:']);
const parts = [...larch.parts.values()];
const half = Math.max(...parts.flatMap(p => p.vertices.map(v => Math.max(...v.at.map(Math.abs)))));
let plain;
for (const bits of [32, 16, 14, 12, 10]) {
  const most = 2 ** (bits - 1) - 1;
  let [bytes, worst, squares, count] = [0, 0, 0, 0];
  for (const { vertices, index } of parts) {
    const [moved, unique] = MeshoptEncoder.reorderMesh(new Uint32Array(index), true, true);
    const raw = bits === 32 ? new Float32Array(3 * unique) : new Int16Array(4 * unique);
    vertices.forEach(({ at }, k) => {
      const to = moved[k];
      if (to === 0xffffffff) return;
      if (bits === 32) return raw.set(at, 3 * to);
      const steps = at.map(x => Math.round(x / half * most));
      raw.set(steps, 4 * to);
      const off = 1000 * distance(steps.map(s => s * half / most), at);
      [worst, squares, count] = [Math.max(worst, off), squares + off ** 2, count + 1];
    });
    const stride = bits === 32 ? 12 : 8;
    bytes += MeshoptEncoder.encodeVertexBuffer(new Uint8Array(raw.buffer), unique, stride).length;
  }
  plain ??= bytes;
  const told = bits === 32 ? ['0', '0'] : [worst.toFixed(2), Math.sqrt(squares / count).toFixed(2)];
  row([bits, ...told, kilo(bytes), `${(100 * bytes / plain).toFixed(0)} %`]);
}
