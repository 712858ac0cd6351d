import * as THREE from 'three';
import { GLTFLoader } from 'GLTFLoader';
import { HDRLoader } from 'HDRLoader';
import { OrbitControls } from 'OrbitControls';

const QUARTER = -Math.PI / 2; // the panorama of three.js has +X in its middle, ours +Z
const CHANNELS = { albedo: 0, specular: 1, roughness: 2 };

/**
 * Shows the bytes of a .glb under the bytes of an .hdr (or an even sky), first from the direction `toward` where there
 * is one; resolves when the first picture is drawn. `photographs` can be put beside it, seen from their own cameras.
 */
export async function start({ asset, light, toward, photographs = [] }) {
  const element = (id) => document.getElementById(id);
  const asked = new URLSearchParams(location.hash.slice(1));

  const renderer = new THREE.WebGLRenderer({ canvas: element("canvas"), antialias: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.toneMapping = THREE.NoToneMapping;
  const scene = new THREE.Scene();
  const plain = new THREE.Color(0x17181b);
  const lamps = { own: light && { panorama: readLight(light), turn: QUARTER }, even: { panorama: evenSky(), turn: 0 } };
  if (!light) element("lamp").querySelector("[value=own]").remove();

  const { scene: model } = await new GLTFLoader().parseAsync(asset, "");
  scene.add(model);
  const meshes = [];
  model.traverse((node) => { if (node.isMesh) meshes.push(node); });
  if (!meshes.length) throw new Error("the file has no mesh");
  const shown = meshes.map((mesh) => ({ mesh, materials: materialsOf(mesh) }));
  const wires = shown.map(({ mesh }) => addWires(mesh));

  const bounds = new THREE.Box3().setFromObject(model).getBoundingSphere(new THREE.Sphere());
  const radius = bounds.radius || 1;
  const camera = new THREE.PerspectiveCamera(35, 1, radius / 100, radius * 100);
  const controls = new OrbitControls(camera, renderer.domElement);
  const direction = new THREE.Vector3(...(toward || [0.55, 0.35, 1])).normalize();
  const distance = (1.15 * radius) / Math.sin(THREE.MathUtils.degToRad(17.5));
  controls.target.copy(bounds.center);
  camera.position.copy(bounds.center).addScaledVector(direction, distance);
  controls.enableDamping = true;
  controls.autoRotateSpeed = 2;

  const triangles = meshes.reduce((sum, { geometry: g }) => sum + (g.index || g.attributes.position).count / 3, 0);
  element("facts").textContent = `${triangles.toLocaleString("en")} triangles. Drag to turn, wheel to come nearer.`;

  const beside = element("photograph"), choice = element("beside");
  choice.parentElement.hidden = !photographs.length;
  for (const { name } of photographs) choice.add(new Option(name, name));
  const chosen = () => photographs.find(({ name }) => name === choice.value);

  /** Puts the camera where a photograph was taken from, or back to where it is free. */
  function compare() {
    const photograph = chosen();
    document.body.classList.toggle("split", Boolean(photograph));
    camera.clearViewOffset();
    if (photograph) {
      beside.src = photograph.address;
      const pose = new THREE.Matrix4().fromArray(photograph.columns);
      camera.position.setFromMatrixPosition(pose);
      camera.quaternion.setFromRotationMatrix(pose);
      const ahead = new THREE.Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
      const depth = bounds.center.clone().sub(camera.position).dot(ahead);
      camera.up.set(0, 1, 0).applyQuaternion(camera.quaternion);
      controls.target.copy(camera.position).addScaledVector(ahead, Math.max(depth, radius / 10));
    } else {
      camera.up.set(0, 1, 0);
      controls.target.copy(bounds.center);
    }
    resize();
  }

  function apply() {
    const channel = document.querySelector("[name=channel]:checked").value;
    for (const { mesh, materials } of shown) mesh.material = materials[channel];
    for (const wire of wires) wire.visible = element("wireframe").checked;
    const degrees = Number(element("turn").value), stops = Number(element("exposure").value);
    element("turned").textContent = `${degrees}°`;
    element("stops").textContent = `${stops > 0 ? "+" : ""}${stops}`;
    const { panorama, turn } = lamps[element("lamp").value];
    scene.environment = panorama;
    scene.environmentRotation.set(0, turn + THREE.MathUtils.degToRad(degrees), 0);
    scene.backgroundRotation.copy(scene.environmentRotation);
    scene.background = element("background").checked ? panorama : plain;
    scene.environmentIntensity = scene.backgroundIntensity = 2 ** stops;
    controls.autoRotate = element("spin").checked;
  }
  for (const [name, value] of asked) {
    const choice = document.querySelector(`[name="${CSS.escape(name)}"][value="${CSS.escape(value)}"]`);
    const box = element(name);
    if (choice) choice.checked = true;
    else if (box && box.type === "checkbox") box.checked = true;
    else if (box && (box.type === "range" || box.id === "lamp")) box.value = value;
  }
  element("panel").addEventListener("input", apply);
  apply();
  // a page that has put this one into a frame may choose what is shown
  addEventListener("message", ({ data }) => {
    if (!data || data.sender !== "hir report") return;
    const choice = document.querySelector(`[name=channel][value="${CSS.escape(data.channel)}"]`);
    if (choice) choice.checked = true;
    element("wireframe").checked = Boolean(data.wireframe);
    apply();
    wake();
  });

  function resize() {
    const photograph = chosen(), canvas = renderer.domElement;
    if (photograph) {
      const { width, height, offset } = photograph;
      const left = asked.has("bare") ? 0 : element("panel").getBoundingClientRect().right + 16;
      const scale = Math.min((innerWidth - left) / 2 / width, innerHeight / height);
      for (const [index, shown] of [canvas, beside].entries()) {
        Object.assign(shown.style, {
          width: `${scale * width}px`, height: `${scale * height}px`, left: `${left + index * scale * width}px`,
        });
      }
      renderer.setSize(scale * width, scale * height, false);
      camera.aspect = width / height;
      camera.fov = photograph.fovYDeg;
      camera.setViewOffset(width, height, ...offset, width, height);
      camera.updateProjectionMatrix();
      return;
    }
    canvas.style.width = canvas.style.height = canvas.style.left = "";
    renderer.setSize(innerWidth, innerHeight, false);
    camera.aspect = innerWidth / innerHeight;
    camera.fov = camera.aspect < 1 ? 2 * Math.atan(Math.tan(Math.PI * 35 / 360) / camera.aspect) * 180 / Math.PI : 35;
    camera.updateProjectionMatrix();
  }
  // pictures are drawn when something moves, not sixty times a second
  let waiting = 0;
  const draw = () => {
    waiting = 0;
    const moving = controls.update();
    renderer.render(scene, camera);
    if (moving || controls.autoRotate) wake();
  };
  const wake = () => { waiting ||= requestAnimationFrame(draw); };
  controls.addEventListener("change", wake);
  element("panel").addEventListener("input", wake);
  addEventListener("resize", () => { resize(); wake(); });
  choice.addEventListener("change", () => { compare(); wake(); });
  if (asked.has("beside")) choice.value = asked.get("beside");
  compare();
  draw();
}

function readLight(bytes) {
  const { data, width, height } = new HDRLoader().setDataType(THREE.FloatType).parse(bytes);
  return panoramaOf(data, width, height);
}

function evenSky() {
  const data = new Float32Array(4 * 8 * 16).fill(0.8);
  return panoramaOf(data, 16, 8);
}

function panoramaOf(data, width, height) {
  const texture = new THREE.DataTexture(data, width, height, THREE.RGBAFormat, THREE.FloatType);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.colorSpace = THREE.LinearSRGBColorSpace;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.flipY = true;
  texture.needsUpdate = true;
  return texture;
}

/** The material as it is, and one of each channel. */
function materialsOf(mesh) {
  const lit = mesh.material;
  const found = { lit, normals: new THREE.MeshNormalMaterial({ normalMap: lit.normalMap, normalScale: lit.normalScale }) };
  for (const [name, channel] of Object.entries(CHANNELS)) found[name] = channelMaterial(lit, channel);
  return found;
}

function channelMaterial(lit, channel) {
  const white = new THREE.DataTexture(new Uint8Array([255, 255, 255, 255]), 1, 1);
  white.needsUpdate = true;
  const ior = lit.ior ?? 1.5;
  return new THREE.ShaderMaterial({
    uniforms: {
      channel: { value: channel },
      base: { value: lit.map || white }, baseFactor: { value: lit.color },
      packed: { value: lit.roughnessMap || lit.metalnessMap || white },
      roughness: { value: lit.roughness ?? 1 }, metalness: { value: lit.metalness ?? 0 },
      weight: { value: lit.specularIntensityMap || white }, weightFactor: { value: lit.specularIntensity ?? 1 },
      tint: { value: lit.specularColorMap || white }, tintFactor: { value: lit.specularColor || new THREE.Color(1, 1, 1) },
      f0: { value: ((ior - 1) / (ior + 1)) ** 2 },
    },
    vertexShader: `
      varying vec2 place;
      void main() {
        place = uv;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: `
      uniform int channel;
      uniform sampler2D base, packed, weight, tint;
      uniform vec3 baseFactor, tintFactor;
      uniform float roughness, metalness, weightFactor, f0;
      varying vec2 place;
      void main() {
        vec3 color = texture2D(base, place).rgb * baseFactor;
        vec4 orm = texture2D(packed, place);
        float metal = orm.b * metalness;
        vec3 mirror = min(f0 * texture2D(tint, place).rgb * tintFactor, 1.0) * texture2D(weight, place).a * weightFactor;
        vec3 shown = channel == 0 ? color : mix(mirror, color, metal);
        gl_FragColor = vec4(channel == 2 ? vec3(orm.g * roughness) : shown, 1.0);
        if (channel != 2) gl_FragColor = linearToOutputTexel(gl_FragColor);
      }`,
  });
}

function addWires(mesh) {
  const material = new THREE.MeshBasicMaterial({
    wireframe: true, color: 0xe58a5c, transparent: true, opacity: 0.55,
    polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1,
  });
  const wire = new THREE.Mesh(mesh.geometry, material);
  wire.visible = false;
  mesh.add(wire);
  return wire;
}
