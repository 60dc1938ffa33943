// Grows trees with ez-tree and prints the processor time of each, for trees.py beside this file.
// Usage: node trees.mjs FOLDER PRESET COUNT   (FOLDER holds node_modules)
import { createRequire } from "node:module";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [folder, preset, count] = process.argv.slice(2);
// Textures want a document; nothing is drawn here.
const element = { addEventListener() {}, removeEventListener() {}, style: {}, getContext: () => null };
globalThis.document = { createElement: () => element, createElementNS: () => element };

const library = createRequire(path.resolve(folder, "package.json")).resolve("@dgreenheck/ez-tree");
const { Tree } = await import(pathToFileURL(library.replace("ez-tree.umd.js", "ez-tree.es.js")));
const grow = (seed) => {
  const tree = new Tree();
  tree.loadPreset(preset);
  tree.options.seed = seed;
  tree.generate();
  return (tree.branchesMesh.geometry.index.count + tree.leavesMesh.geometry.index.count) / 3;
};
for (let warm = 0; warm < 10; warm++) grow(warm);
let triangles = 0;
const [cpu, wall] = [process.cpuUsage(), process.hrtime.bigint()];
for (let seed = 0; seed < Number(count); seed++) triangles += grow(seed);
const used = process.cpuUsage(cpu);
console.log(JSON.stringify({
  triangles,
  seconds: Number(process.hrtime.bigint() - wall) / 1e9,
  cpu_seconds: (used.user + used.system) / 1e6,
}));
