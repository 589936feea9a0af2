// glTF files as other people's readers see them, for tools/validate.py. Prints JSON.
//
//     node tools/readers.mjs decode FILE OUT           compressed views decoded, into OUT.glb
//     node tools/readers.mjs transform FILES…          what glTF-Transform finds in each
//     node tools/readers.mjs three FILE=PICTURE…       what three.js finds in each in headless
//                                                      Chromium, and how it looks
//
// Modules are looked for in $LARIX_NODE_MODULES, else beside this file.

import fs from 'node:fs';
import http from 'node:http';
import path from 'node:path';
import { createRequire } from 'node:module';
import { fileURLToPath, pathToFileURL } from 'node:url';

const here = path.dirname(fileURLToPath(import.meta.url));
const modules = path.resolve(process.env.LARIX_NODE_MODULES || path.join(here, 'node_modules'));
const require = createRequire(path.join(modules, 'anything.js'));
const load = name => import(pathToFileURL(require.resolve(name)).href);

function chunks(file) {
  const data = fs.readFileSync(file);
  if (file.endsWith('.gltf')) {
    const json = JSON.parse(data.toString());
    const buffer = path.join(path.dirname(file), decodeURIComponent(json.buffers[0].uri));
    return [json, fs.readFileSync(buffer)];
  }
  const length = data.readUInt32LE(12);
  return [JSON.parse(data.subarray(20, 20 + length).toString()), data.subarray(28 + length)];
}

// One buffer of decoded views instead of a compressed one and its stand-in.
async function decode(file, out) {
  const { MeshoptDecoder } = await load('meshoptimizer');
  await MeshoptDecoder.ready;
  const [json, binary] = chunks(file);
  const parts = [];
  let end = 0;
  for (const view of json.bufferViews) {
    const packed = view.extensions?.EXT_meshopt_compression;
    let bytes;
    if (packed) {
      bytes = new Uint8Array(packed.count * packed.byteStride);
      const source = binary.subarray(packed.byteOffset ?? 0, (packed.byteOffset ?? 0) + packed.byteLength);
      MeshoptDecoder.decodeGltfBuffer(bytes, packed.count, packed.byteStride, source, packed.mode, packed.filter);
      if (bytes.length !== view.byteLength) throw new Error(`a view of ${view.byteLength} bytes holds ${bytes.length}`);
      delete view.extensions;
    } else {
      bytes = binary.subarray(view.byteOffset ?? 0, (view.byteOffset ?? 0) + view.byteLength);
    }
    parts.push(bytes, new Uint8Array((4 - (bytes.length % 4)) % 4));
    Object.assign(view, { buffer: 0, byteOffset: end });
    end += bytes.length + parts.at(-1).length;
  }
  json.buffers = [{ byteLength: end }];
  const kept = name => name !== 'EXT_meshopt_compression';
  json.extensionsUsed = json.extensionsUsed?.filter(kept);
  json.extensionsRequired = json.extensionsRequired?.filter(kept);
  let text = Buffer.from(JSON.stringify(json));
  text = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, ' ')]);
  const head = Buffer.alloc(20);
  head.write('glTF');
  [2, 28 + text.length + end, text.length].forEach((word, k) => head.writeUInt32LE(word, 4 + 4 * k));
  head.write('JSON', 16);
  const middle = Buffer.alloc(8);
  middle.writeUInt32LE(end);
  middle.write('BIN\0', 4);
  fs.writeFileSync(out, Buffer.concat([head, text, middle, ...parts]));
  return {};
}

async function transform(files) {
  const { NodeIO } = await load('@gltf-transform/core');
  const { ALL_EXTENSIONS } = await load('@gltf-transform/extensions');
  const { MeshoptDecoder } = await load('meshoptimizer');
  await MeshoptDecoder.ready;
  const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).registerDependencies({ 'meshopt.decoder': MeshoptDecoder });
  const out = {};
  for (const file of files) {
    const root = (await io.read(file)).getRoot();
    const found = { meshes: root.listMeshes().length, drawn: 0, triangles: 0, textures: root.listTextures().length };
    const textures = root.listTextures().filter(t => t.getSize() === null).map(t => t.getName());
    if (textures.length) throw new Error(`${file}: no size of ${textures}`);
    root.listScenes()[0].traverse(node => {
      const mesh = node.getMesh();
      if (!mesh) return;
      const placed = node.getExtension('EXT_mesh_gpu_instancing');
      const times = placed ? placed.getAttribute('TRANSLATION').getCount() : 1;
      found.drawn += times * mesh.listPrimitives().length;
      for (const p of mesh.listPrimitives()) found.triangles += times * p.getIndices().getCount() / 3;
    });
    out[file] = found;
  }
  return out;
}

const PAGE = `<!doctype html><meta charset="utf-8"><style>body{margin:0}</style>
<script type="importmap">{"imports":{"three":"/m/three/build/three.module.js","three/addons/":"/m/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { MeshoptDecoder } from 'three/addons/libs/meshopt_decoder.module.js';
const extensions = [];
window.look = async (url, isForest) => {
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  renderer.setSize(960, 540);
  document.body.replaceChildren(renderer.domElement);
  const start = performance.now();
  const gltf = await new GLTFLoader().setMeshoptDecoder(MeshoptDecoder).loadAsync(url);
  const seconds = (performance.now() - start) / 1000;
  const found = { objects: 0, drawn: 0, triangles: 0, textures: 0, seconds };
  const bounds = new THREE.Box3(), at = new THREE.Vector3(), matrix = new THREE.Matrix4(), textures = new Set();
  gltf.scene.updateMatrixWorld(true);
  gltf.scene.traverse(object => {
    found.objects += 1;
    if (!object.isMesh) return;
    const body = /^UC[XP]_/.test(object.name) || /^UC[XP]_/.test(object.parent?.name ?? '');
    const times = object.isInstancedMesh ? object.count : 1;
    const geometry = object.geometry, position = geometry.attributes.position;
    found.drawn += times;
    found.triangles += times * geometry.index.count / 3;
    for (const slot of ['map', 'normalMap', 'roughnessMap', 'aoMap']) {
      const texture = object.material[slot];
      if (texture) { if (!texture.image?.width) throw new Error('no picture in ' + object.material.name); textures.add(texture.source.uuid); }
    }
    if (body) { object.visible = false; }
    const corners = [];
    for (let i = 0; i < position.count; i++) corners.push(at.fromBufferAttribute(position, i).clone());
    for (let k = 0; k < times; k++) {
      if (object.isInstancedMesh) { object.getMatrixAt(k, matrix); matrix.premultiply(object.matrixWorld); } else matrix.copy(object.matrixWorld);
      for (const corner of corners) bounds.expandByPoint(at.copy(corner).applyMatrix4(matrix));
    }
  });
  found.textures = textures.size;
  found.bounds = [bounds.min.toArray(), bounds.max.toArray()];
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xbfd4e6);
  scene.add(gltf.scene, new THREE.HemisphereLight(0xcfe0f0, 0x5a5040, 2.2));
  const sun = new THREE.DirectionalLight(0xfff2dc, 3.2);
  sun.position.set(0.6, 1, 0.4);
  scene.add(sun);
  const size = bounds.getSize(at.clone()), middle = bounds.getCenter(new THREE.Vector3());
  const reach = Math.max(size.x, size.y, size.z);
  const camera = new THREE.PerspectiveCamera(40, 960 / 540, 0.1, 20 * reach);
  // A forest from where tools/render_blender.py looks at it.
  const way = isForest ? [0.55, 0.6, 0.88] : [0, 0.1, 1.55];
  camera.position.copy(middle).add(new THREE.Vector3(...way).multiplyScalar(reach));
  camera.lookAt(middle);
  renderer.render(scene, camera);
  found.calls = renderer.info.render.calls;
  return found;
};
window.ready = true;
</script>`;

async function three(pairs) {
  const { chromium } = (await load('playwright-core')).default;
  const server = http.createServer((request, response) => {
    const where = decodeURIComponent(new URL(request.url, 'http://x').pathname);
    if (where === '/favicon.ico') return response.writeHead(204).end();
    if (where === '/') return response.setHeader('content-type', 'text/html').end(PAGE);
    const file = where.startsWith('/m/') ? path.join(modules, where.slice(3)) : where.slice(2);
    if (!fs.existsSync(file)) return response.writeHead(404).end();
    const kinds = { '.js': 'text/javascript', '.png': 'image/png', '.webp': 'image/webp' };
    response.setHeader('content-type', kinds[path.extname(file)] ?? 'application/octet-stream');
    fs.createReadStream(file).pipe(response);
  });
  await new Promise(done => server.listen(0, '127.0.0.1', done));
  const browser = await chromium.launch({
    executablePath: process.env.LARIX_CHROMIUM || '/usr/bin/chromium',
    args: ['--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking',
      '--disable-component-update', '--disable-sync', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist'],
  });
  const out = {};
  try {
    for (const pair of pairs) {
      const [file, picture] = pair.split('=');
      const page = await browser.newPage({ viewport: { width: 960, height: 540 } });
      page.setDefaultTimeout(300000);
      const said = [];
      page.on('console', message => { if (['warning', 'error'].includes(message.type())) said.push(message.text()); });
      page.on('pageerror', error => said.push(String(error)));
      await page.goto(`http://127.0.0.1:${server.address().port}/`);
      await page.waitForFunction(() => window.ready);
      const url = '/f' + encodeURI(path.resolve(file));
      const isForest = path.basename(file).startsWith('forest');
      const found = await page.evaluate(([url, isForest]) => window.look(url, isForest), [url, isForest]);
      // What the software renderer says of its own speed is no fault of the file.
      found.said = said.filter(text => !/GPU stall|GL Driver Message|software WebGL/i.test(text));
      if (picture) await page.locator('canvas').screenshot({ path: picture });
      await page.close();
      out[file] = found;
    }
  } finally {
    await browser.close();
    server.close();
  }
  return out;
}

const [task, ...rest] = process.argv.slice(2);
const tasks = { decode: () => decode(...rest), transform: () => transform(rest), three: () => three(rest) };
if (!tasks[task]) throw new Error(`no task ${task}`);
console.log(JSON.stringify(await tasks[task]()));
