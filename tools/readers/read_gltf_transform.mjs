// Reads glTF files with glTF-Transform: `node read_gltf_transform.mjs FILE…` prints one JSON list of descriptions.
import { Logger, NodeIO, getBounds } from '@gltf-transform/core';
import { ALL_EXTENSIONS } from '@gltf-transform/extensions';
import draco3d from 'draco3dgltf';
import { MeshoptDecoder } from 'meshoptimizer';

await MeshoptDecoder.ready;
const ignored = [];
const io = new NodeIO()
  .registerExtensions(ALL_EXTENSIONS)
  .registerDependencies({ 'draco3d.decoder': await draco3d.createDecoderModule(), 'meshopt.decoder': MeshoptDecoder });
io.setLogger({
  debug() {}, info() {},
  warn(text) { ignored.push(...(text.match(/[A-Z]+_[a-z_0-9]+/g) ?? [text])); },
  error(text) { ignored.push(text); },
});

async function description(file) {
  ignored.length = 0;
  const document = await io.read(file);
  const scene = document.getRoot().getDefaultScene();
  const { min, max } = getBounds(scene);
  let triangles = 0;
  const meshes = [];
  let material = null;
  scene.traverse((node) => {
    if (node.getMesh() === null) return;
    meshes.push(node.getName());
    for (const primitive of node.getMesh().listPrimitives()) {
      triangles += primitive.getIndices().getCount() / 3;
      material ??= primitive.getMaterial();
    }
  });
  const old = material.getExtension('KHR_materials_pbrSpecularGlossiness');
  const slots = old === null
    ? { color: material.getBaseColorTexture(), roughness: material.getMetallicRoughnessTexture() }
    : { color: old.getDiffuseTexture(), roughness: old.getSpecularGlossinessTexture() };
  slots.normal = material.getNormalTexture();
  const textures = {};
  for (const [slot, texture] of Object.entries(slots)) if (texture) textures[slot] = texture.getSize();
  return { triangles, low: min, high: max, meshes, textures, ignored: [...new Set(ignored)] };
}

const found = [];
for (const file of process.argv.slice(2)) {
  try { found.push(await description(file)); } catch (error) { found.push({ error: String(error.message ?? error) }); }
}
console.log(JSON.stringify(found));
