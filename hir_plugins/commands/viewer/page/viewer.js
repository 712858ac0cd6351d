import * as THREE from 'three';
import { GLTFLoader } from 'GLTFLoader';
import { HDRLoader } from 'HDRLoader';
import { OrbitControls } from 'OrbitControls';

const LIGHT_ROTATION_RAD = -Math.PI / 2; // three.js puts +X at the centre of a lat-long map, hir +Z
const CHANNELS = { albedo: 0, specular: 1, roughness: 2, metalness: 3 };

/**
 * Displays the bytes of a .glb under the bytes of an .hdr, or under a uniform light. The first camera looks from
 * `initialDirection` if there is one. Resolves when the first image is drawn. `photographs` can be displayed beside the
 * asset, which is then seen from the photograph's camera.
 */
export async function start({ asset, light, initialDirection, photographs = [] }) {
  const element = (id) => document.getElementById(id);
  const urlSettings = new URLSearchParams(location.hash.slice(1));

  const renderer = new THREE.WebGLRenderer({ canvas: element("canvas"), antialias: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.toneMapping = THREE.NoToneMapping;
  const scene = new THREE.Scene();
  const backgroundColor = new THREE.Color(0x17181b);
  const lights = {
    asset: light && { map: readLight(light), rotationRad: LIGHT_ROTATION_RAD },
    uniform: { map: uniformLight(), rotationRad: 0 },
  };
  if (!light) element("light").querySelector("[value=asset]").remove();

  const { scene: model } = await new GLTFLoader().parseAsync(asset, "");
  scene.add(model);
  const meshes = [];
  model.traverse((node) => { if (node.isMesh) meshes.push(node); });
  if (!meshes.length) throw new Error("the file has no mesh");
  const variants = meshes.map((mesh) => ({ mesh, materials: materialsOf(mesh) }));
  const wireframes = meshes.map(addWireframe);

  const bounds = new THREE.Box3().setFromObject(model).getBoundingSphere(new THREE.Sphere());
  const radius = bounds.radius || 1;
  const camera = new THREE.PerspectiveCamera(35, 1, radius / 100, radius * 100);
  const controls = new OrbitControls(camera, renderer.domElement);
  const direction = new THREE.Vector3(...(initialDirection || [0.55, 0.35, 1])).normalize();
  const distance = (1.15 * radius) / Math.sin(THREE.MathUtils.degToRad(17.5));
  controls.target.copy(bounds.center);
  camera.position.copy(bounds.center).addScaledVector(direction, distance);
  controls.enableDamping = true;
  controls.autoRotateSpeed = 2;

  const triangles = meshes.reduce((sum, { geometry: g }) => sum + (g.index || g.attributes.position).count / 3, 0);
  element("facts").textContent = `${triangles.toLocaleString("en")} triangles. Drag to rotate, scroll to zoom.`;

  const photographImage = element("photograph-image"), choice = element("photograph");
  choice.parentElement.hidden = !photographs.length;
  for (const { name } of photographs) choice.add(new Option(name, name));
  const selectedPhotograph = () => photographs.find(({ name }) => name === choice.value);

  /** Moves the camera to the selected photograph's, or resets it. */
  function selectCamera() {
    const photograph = selectedPhotograph();
    document.body.classList.toggle("split", Boolean(photograph));
    camera.clearViewOffset();
    if (photograph) {
      photographImage.src = photograph.address;
      const pose = new THREE.Matrix4().fromArray(photograph.cameraToWorld);
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
    for (const { mesh, materials } of variants) mesh.material = materials[channel];
    for (const wireframe of wireframes) wireframe.visible = element("wireframe").checked;
    const degrees = Number(element("rotation").value), stops = Number(element("exposure").value);
    element("rotation-value").textContent = `${degrees}°`;
    element("exposure-value").textContent = `${stops > 0 ? "+" : ""}${stops}`;
    const { map, rotationRad } = lights[element("light").value];
    scene.environment = map;
    scene.environmentRotation.set(0, rotationRad + THREE.MathUtils.degToRad(degrees), 0);
    scene.backgroundRotation.copy(scene.environmentRotation);
    scene.background = element("background").checked ? map : backgroundColor;
    scene.environmentIntensity = scene.backgroundIntensity = 2 ** stops;
    controls.autoRotate = element("spin").checked;
  }
  for (const [name, value] of urlSettings) {
    const choice = document.querySelector(`[name="${CSS.escape(name)}"][value="${CSS.escape(value)}"]`);
    const box = element(name);
    if (choice) choice.checked = true;
    else if (box && box.type === "checkbox") box.checked = true;
    else if (box && (box.type === "range" || box.id === "light")) box.value = value;
  }
  element("panel").addEventListener("input", apply);
  apply();
  // the report embeds this page in a frame and selects the channel by messages
  addEventListener("message", ({ data }) => {
    if (!data || data.sender !== "hir report") return;
    const choice = document.querySelector(`[name=channel][value="${CSS.escape(data.channel)}"]`);
    if (choice) choice.checked = true;
    element("wireframe").checked = Boolean(data.wireframe);
    apply();
    requestDraw();
  });

  function resize() {
    const photograph = selectedPhotograph(), canvas = renderer.domElement;
    if (photograph) {
      const { width, height, offset } = photograph;
      const left = urlSettings.has("bare") ? 0 : element("panel").getBoundingClientRect().right + 16;
      const scale = Math.min((innerWidth - left) / 2 / width, innerHeight / height);
      for (const [index, image] of [canvas, photographImage].entries()) {
        Object.assign(image.style, {
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
  // an image is drawn only when something changes
  let pendingFrame = 0;
  const draw = () => {
    pendingFrame = 0;
    const moving = controls.update();
    renderer.render(scene, camera);
    if (moving || controls.autoRotate) requestDraw();
  };
  const requestDraw = () => { pendingFrame ||= requestAnimationFrame(draw); };
  controls.addEventListener("change", requestDraw);
  element("panel").addEventListener("input", requestDraw);
  addEventListener("resize", () => { resize(); requestDraw(); });
  choice.addEventListener("change", () => { selectCamera(); requestDraw(); });
  if (urlSettings.has("photograph")) choice.value = urlSettings.get("photograph");
  selectCamera();
  draw();
}

function readLight(bytes) {
  const { data, width, height } = new HDRLoader().setDataType(THREE.FloatType).parse(bytes);
  return latLongTexture(data, width, height);
}

function uniformLight() {
  const data = new Float32Array(4 * 8 * 16).fill(0.8);
  return latLongTexture(data, 16, 8);
}

function latLongTexture(data, width, height) {
  const texture = new THREE.DataTexture(data, width, height, THREE.RGBAFormat, THREE.FloatType);
  texture.mapping = THREE.EquirectangularReflectionMapping;
  texture.colorSpace = THREE.LinearSRGBColorSpace;
  texture.minFilter = texture.magFilter = THREE.LinearFilter;
  texture.flipY = true;
  texture.needsUpdate = true;
  return texture;
}

/** The material itself, and one unlit material for each channel. */
function materialsOf(mesh) {
  const lit = mesh.material;
  const materials = { lit, normals: new THREE.MeshNormalMaterial({ normalMap: lit.normalMap, normalScale: lit.normalScale }) };
  for (const [name, channel] of Object.entries(CHANNELS)) materials[name] = channelMaterial(lit, channel);
  return materials;
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
      varying vec2 texcoord;
      void main() {
        texcoord = uv;
        gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
      }`,
    fragmentShader: `
      uniform int channel;
      uniform sampler2D base, packed, weight, tint;
      uniform vec3 baseFactor, tintFactor;
      uniform float roughness, metalness, weightFactor, f0;
      varying vec2 texcoord;
      void main() {
        vec3 color = texture2D(base, texcoord).rgb * baseFactor;
        vec4 orm = texture2D(packed, texcoord);
        float metal = orm.b * metalness;
        vec3 specularF0 = min(f0 * texture2D(tint, texcoord).rgb * tintFactor, 1.0) * texture2D(weight, texcoord).a * weightFactor;
        vec3 value = channel == 0 ? color : mix(specularF0, color, metal);
        gl_FragColor = vec4(channel == 2 ? vec3(orm.g * roughness) : channel == 3 ? vec3(metal) : value, 1.0);
        if (channel < 2) gl_FragColor = linearToOutputTexel(gl_FragColor);
      }`,
  });
}

function addWireframe(mesh) {
  const material = new THREE.MeshBasicMaterial({
    wireframe: true, color: 0xe58a5c, transparent: true, opacity: 0.55,
    polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1,
  });
  const wireframe = new THREE.Mesh(mesh.geometry, material);
  wireframe.visible = false;
  mesh.add(wireframe);
  return wireframe;
}
