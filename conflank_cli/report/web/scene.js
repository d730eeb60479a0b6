// What is seen: design faces, the rest of the part, obstacles, ruled surfaces, path, cutter, places.

import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Face, gapScale } from "./faces.js";

const STEEL = { flute: 0xe9c46a, shank: 0xb9bcc2, holder: 0x8a8f98 };
const TURN = Math.PI / 36; // of the view at a press of an arrow key
const MOVING = 1; // the layer of what is drawn over the kept picture
const SETTLED = 200; // ms after the last move until the picture is made smooth

function vector(values, k = 0) {
  return new THREE.Vector3(values[k], values[k + 1], values[k + 2]);
}

export class View {
  constructor(canvas, report, arrays, motion) {
    this.report = report;
    this.motion = motion;
    this.canvas = canvas;
    // Edges are smooth as soon as nothing moves: see render().
    const settings = { alpha: true, antialias: false, powerPreference: "high-performance" };
    const context = canvas.getContext("webgl2", settings);
    if (!context) throw new Error("no WebGL");
    this.renderer = new THREE.WebGLRenderer({ canvas, context, ...settings });
    this.scene = new THREE.Scene();
    this.layers = new Map();
    this.faces = report.faces.map((entry) => new Face(entry, arrays, report));
    const faces = this.layer("faces");
    this.faces.forEach((face) => faces.add(face.mesh));
    this.scale = gapScale(report.colours, report.tolerance.overcut_um, report.tolerance.undercut_um);
    this.layer("rest").add(this.body(arrays.rest_vertices, arrays.rest_triangles, report.colours.rest));
    this.layer("obstacles").add(this.body(arrays.obstacle_vertices, arrays.obstacle_triangles, report.colours.obstacle));
    this.addCuts();
    this.addCutters();
    this.addPlaces();
    this.addLights();
    this.addCamera();
    this.kept = new Kept();
    this.dirty = true; // something else than the cutter has changed
    this.moved = false; // the cutter has
    this.smooth = false; // the picture on the screen has smooth edges
    this.drawnAt = 0;
  }

  layer(name) {
    if (!this.layers.has(name)) {
      const group = new THREE.Group();
      this.layers.set(name, group);
      this.scene.add(group);
    }
    return this.layers.get(name);
  }

  body(vertices, triangles, colour) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
    geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(triangles), 1));
    geometry.computeVertexNormals();
    return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color: colour, side: THREE.DoubleSide }));
  }

  // Solid, see-through or hidden.
  rest(state) {
    const group = this.layer("rest");
    group.visible = state !== "hidden";
    group.children.forEach(({ material }) => {
      material.transparent = state === "through";
      material.opacity = state === "through" ? 0.16 : 1;
      material.depthWrite = state !== "through";
      material.needsUpdate = true;
    });
    this.dirty = true;
  }

  addCuts() {
    const { motion, report } = this;
    const ways = { path: [[], []], rapids: [[], []] };
    const ends = (i, tool) => {
      const tip = vector(motion.tip, 3 * i);
      const axis = vector(motion.axis, 3 * i);
      return [tool.low, tool.high].map((height) => tip.clone().addScaledVector(axis, height));
    };
    const strips = report.cuts.map(() => []);
    for (let i = 1; i < motion.count; i++) {
      if (!motion.joined[i]) continue;
      const cut = motion.cut[i];
      const colour = new THREE.Color(cut < 0 ? report.colours.rapid : report.cuts[cut].colour);
      const [lines, colours] = ways[motion.rapid[i] ? "rapids" : "path"];
      for (const k of [i - 1, i]) {
        lines.push(motion.tip[3 * k], motion.tip[3 * k + 1], motion.tip[3 * k + 2]);
        colours.push(colour.r, colour.g, colour.b);
      }
      const tool = report.tools[motion.tool[i]];
      if (cut >= 0 && tool) {
        const [a, b] = ends(i - 1, tool);
        const [c, d] = ends(i, tool);
        strips[cut].push(a, c, b, b, c, d);
      }
    }
    for (const [name, [lines, colours]] of Object.entries(ways)) {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.Float32BufferAttribute(lines, 3));
      geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
      this.layer(name).add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true })));
    }
    report.cuts.forEach((cut, index) => {
      if (cut.kind !== "sweep") return;
      const geometry = new THREE.BufferGeometry().setFromPoints(strips[index]);
      geometry.computeVertexNormals();
      const material = new THREE.MeshLambertMaterial({
        color: cut.colour, side: THREE.DoubleSide, transparent: true, opacity: 0.55, depthWrite: false,
      });
      this.layer(`ruled:${index}`).add(new THREE.Mesh(geometry, material));
    });
  }

  // Bodies of revolution whose axis is z and whose tip is the origin.
  addCutters() {
    this.cutters = this.report.tools.map((tool) => {
      const group = new THREE.Group();
      for (const part of tool.parts) {
        const profile = part.profile.map(([height, radius]) => new THREE.Vector2(radius, height));
        const geometry = new THREE.LatheGeometry(profile, 48).rotateX(Math.PI / 2);
        const solid = part.kind !== "holder";
        const material = new THREE.MeshLambertMaterial({
          color: STEEL[part.kind], side: THREE.DoubleSide, transparent: !solid, opacity: solid ? 1 : 0.45, depthWrite: solid,
        });
        const mesh = new THREE.Mesh(geometry, material);
        mesh.userData.kind = part.kind;
        mesh.layers.set(MOVING);
        group.add(mesh);
      }
      group.visible = false;
      this.layer("cutter").add(group);
      return group;
    });
  }

  showHolder(on) {
    this.cutters.forEach((group) =>
      group.children.forEach((mesh) => { if (mesh.userData.kind !== "flute") mesh.visible = on; }),
    );
    this.dirty = true;
  }

  addPlaces() {
    const size = this.size() / 130;
    this.marks = this.report.places.map((place) => {
      const material = new THREE.MeshBasicMaterial({
        color: place.finding ? this.report.colours.finding : this.report.colours.place, depthTest: false, transparent: true,
      });
      const mark = new THREE.Mesh(new THREE.SphereGeometry(size, 16, 12), material);
      mark.renderOrder = 10;
      mark.layers.set(MOVING);
      mark.visible = Boolean(place.point);
      if (place.point) mark.position.set(...place.point);
      this.layer("places").add(mark);
      return mark;
    });
  }

  bounds(...objects) {
    const box = new THREE.Box3();
    objects.forEach((object) => box.expandByObject(object));
    return box;
  }

  size() {
    return this.bounds(this.layer("faces")).getSize(new THREE.Vector3()).length();
  }

  addLights() {
    const ambient = new THREE.AmbientLight(0xffffff, 1.9);
    ambient.layers.enable(MOVING);
    this.scene.add(ambient);
    // The light comes with the viewer, from the upper left and a little from the right.
    this.head = new THREE.Group();
    for (const [x, y, z, strength] of [[-0.5, 0.7, 1, 1.35], [1, 0.1, 0.6, 0.45]]) {
      const light = new THREE.DirectionalLight(0xffffff, strength);
      light.position.set(x, y, z);
      light.layers.enable(MOVING);
      this.head.add(light, light.target);
    }
  }

  addCamera() {
    const { motion } = this;
    const up = new THREE.Vector3();
    for (let i = 0; i < motion.count; i++) if (motion.cut[i] >= 0) up.add(vector(motion.axis, 3 * i));
    // The cutter comes from above.
    if (up.length() < 1e-3) up.set(0, 0, 1);
    this.camera = new THREE.PerspectiveCamera(32, 1, 1, 10000);
    this.camera.up.copy(up.normalize());
    this.camera.add(this.head);
    this.scene.add(this.camera);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener("change", () => { this.dirty = true; });
    this.look(0);
  }

  // Look at a face from the cutter's side, a little from above; -1 for everything.
  look(index) {
    const faces = index < 0 ? this.faces : [this.faces[index]];
    const normal = new THREE.Vector3();
    faces.forEach(({ entry }) => normal.add(vector(entry.normal)));
    const around = index < 0 ? [this.layer("rest"), this.layer("obstacles")] : [];
    this.approach(this.bounds(...faces.map((face) => face.mesh), ...around), normal, 1);
  }

  approach(box, normal, margin) {
    const up = this.camera.up;
    const towards = normal.clone().addScaledVector(up, -normal.dot(up));
    if (towards.length() < 0.05) towards.set(up.y, up.z, up.x).addScaledVector(up, -towards.dot(up));
    towards.normalize().addScaledVector(up, 0.42).normalize();
    const centre = box.getCenter(new THREE.Vector3());
    const radius = box.getSize(new THREE.Vector3()).length() / 2;
    const angle = (this.camera.fov * Math.PI) / 360;
    const reach = (margin * radius * Math.max(1, 1 / this.camera.aspect)) / Math.sin(angle);
    this.camera.position.copy(centre).addScaledVector(towards, reach);
    this.camera.near = reach / 60;
    this.camera.far = reach * 40;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(centre);
    this.controls.update();
    this.dirty = true;
  }

  // Come near a place, seen from the side the cutter is on.
  goTo(place) {
    this.marks.forEach((mark, k) => mark.scale.setScalar(this.report.places[k] === place ? 1.8 : 1));
    if (place.point) {
      const centre = new THREE.Vector3(...place.point);
      const box = new THREE.Box3().setFromCenterAndSize(centre, new THREE.Vector3().setScalar(this.size() / 2.5));
      let normal = this.camera.position.clone().sub(centre);
      const face = this.faces.find(({ entry }) => entry.number === place.face);
      if (face) normal = vector(face.entry.normal);
      this.approach(box, normal, 1);
    }
    this.dirty = true;
  }

  paint(mode, shown, marked) {
    const scale = marked
      ? (gap) => (gap > this.report.tolerance.undercut_um ? this.markedColour() : this.scale(gap))
      : this.scale;
    this.faces.forEach((face) => face.paint(mode, shown, scale));
    this.dirty = true;
  }

  markedColour() {
    const value = parseInt(this.report.colours.marked.slice(1), 16);
    return [value >> 16, (value >> 8) & 255, value & 255];
  }

  place(pose, tool) {
    this.cutters.forEach((group, k) => { group.visible = k === tool; });
    const cutter = this.cutters[tool];
    if (cutter) {
      cutter.position.set(...pose.tip);
      cutter.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...pose.axis));
    }
    this.moved = true;
  }

  // The face under the pointer and the place on its picture.
  under(x, y) {
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2(x, y), this.camera);
    for (const hit of ray.intersectObjects(this.faces.map((face) => face.mesh), false)) {
      const face = hit.object.userData.face;
      const k = face.indexAt(hit.uv);
      if (face.inside[k] > 127) return { face, k };
    }
    return null;
  }

  key(event) {
    const offset = this.camera.position.clone().sub(this.controls.target);
    const up = this.camera.up;
    const right = new THREE.Vector3().crossVectors(up, offset).normalize();
    const slope = offset.angleTo(up);
    if (event.key === "ArrowLeft") offset.applyAxisAngle(up, -TURN);
    else if (event.key === "ArrowRight") offset.applyAxisAngle(up, TURN);
    else if (event.key === "ArrowUp" && slope > 2 * TURN) offset.applyAxisAngle(right, -TURN);
    else if (event.key === "ArrowDown" && slope < Math.PI - 2 * TURN) offset.applyAxisAngle(right, TURN);
    else if (event.key === "+" || event.key === "=") offset.multiplyScalar(0.9);
    else if (event.key === "-") offset.multiplyScalar(1 / 0.9);
    else return false;
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.dirty = true;
    return true;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

  background(colour) {
    this.renderer.setClearColor(colour);
    this.dirty = true;
  }

  // Draw if something has changed: everything, or the cutter alone over what was kept of the rest. Smooth edges take
  // several times as long without a graphics card, so they wait until nothing has moved for a while.
  render(now) {
    const { renderer, scene, camera, kept } = this;
    if (!this.dirty && !this.moved) {
      if (this.smooth || now - this.drawnAt < SETTLED) return false;
      camera.layers.enableAll();
      kept.take(renderer, scene, camera);
      kept.show(renderer);
      kept.stale = this.smooth = true;
      return true;
    }
    if (this.dirty) {
      camera.layers.enableAll();
      renderer.render(scene, camera);
      kept.stale = true;
    } else {
      if (kept.stale) {
        camera.layers.set(0);
        kept.take(renderer, scene, camera);
      }
      kept.show(renderer);
      camera.layers.set(MOVING);
      renderer.autoClear = false;
      renderer.render(scene, camera);
      renderer.autoClear = true;
    }
    this.drawnAt = now;
    this.dirty = this.moved = this.smooth = false;
    return true;
  }
}

// A picture with smooth edges and its depths. Only the cutter moves along the program: over the picture of everything else
// it is drawn in a small part of the time that all takes. What is see-through lies behind the cutter then; that is put
// right as soon as the cutter rests.
class Kept {
  constructor() {
    this.stale = true; // it no longer shows everything but the cutter
    this.camera = new THREE.Camera();
    const material = new THREE.ShaderMaterial({
      uniforms: { picture: { value: null }, depths: { value: null } },
      vertexShader: "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }",
      fragmentShader: `uniform sampler2D picture; uniform sampler2D depths; varying vec2 at;
        void main() {
          gl_FragColor = texture2D(picture, at);
          gl_FragDepth = texture2D(depths, at).x;
          #include <colorspace_fragment>
        }`,
      depthFunc: THREE.AlwaysDepth,
    });
    this.sheet = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
    this.sheet.frustumCulled = false;
  }

  take(renderer, scene, camera) {
    const { x: width, y: height } = renderer.getDrawingBufferSize(new THREE.Vector2());
    if (this.target?.width !== width || this.target?.height !== height) {
      this.target?.depthTexture.dispose();
      this.target?.dispose();
      this.target = new THREE.WebGLRenderTarget(width, height, {
        samples: 4, colorSpace: THREE.SRGBColorSpace, depthTexture: new THREE.DepthTexture(width, height, THREE.UnsignedIntType),
      });
      this.sheet.material.uniforms.picture.value = this.target.texture;
      this.sheet.material.uniforms.depths.value = this.target.depthTexture;
    }
    renderer.setRenderTarget(this.target);
    renderer.render(scene, camera);
    renderer.setRenderTarget(null);
    this.stale = false;
  }

  show(renderer) {
    renderer.render(this.sheet, this.camera);
  }
}
