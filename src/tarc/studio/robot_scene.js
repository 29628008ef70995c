// The robot in three dimensions: plays a run that came in one message, with the reference as a ghost.
// three.js is the copy that NiceGUI serves; nothing is drawn while nothing moves.
import { OrbitControls, THREE } from "nicegui-scene";

const GHOST = 0x3c78c8;
const PAYLOAD = 0xe69f00;
const FRAME = 1000 / 30; // [ms]

function floats(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

function integers(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Uint32Array(bytes.buffer);
}

export default {
  template: `
    <div class="robot-scene">
      <canvas role="img" :aria-label="label"></canvas>
      <div class="robot-scene-controls">
        <button type="button" @click="toggle" :aria-label="playing ? 'Pause' : 'Play'" :disabled="!end">
          {{ playing ? "❚❚" : "▶" }}
        </button>
        <input type="range" min="0" :max="end" step="0.01" v-model.number="time" @input="pause"
          aria-label="Time of the run" :aria-valuetext="time.toFixed(2) + ' s'" :disabled="!end" />
        <span class="robot-scene-time">{{ time.toFixed(2) }} s</span>
      </div>
    </div>`,
  props: { label: String, curves: String },
  data: () => ({ playing: false, time: 0, end: 0 }),
  watch: {
    time() {
      this.request();
    },
  },
  mounted() {
    const canvas = this.$el.querySelector("canvas");
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(40, 1.4, 0.01, 1000);
    this.camera.up.set(0, 0, 1);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8d8d8d, 2.5));
    const light = new THREE.DirectionalLight(0xffffff, 1.5);
    light.position.set(2, -4, 6);
    this.scene.add(light);
    this.robot = [];
    this.ghost = [];
    this.root = new THREE.Group();
    this.scene.add(this.root);
    try {
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true, canvas });
    } catch {
      canvas.replaceWith("This browser draws no 3D (WebGL is off).");
      return;
    }
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.request());
    this.observer = new ResizeObserver(() => this.request());
    this.observer.observe(this.$el);
    this.request();
  },
  unmounted() {
    this.gone = true;
    this.observer?.disconnect();
    this.controls?.dispose();
    this.clear();
    this.renderer?.dispose();
    this.renderer?.forceContextLoss();
  },
  methods: {
    clear() {
      this.root.traverse((node) => {
        node.geometry?.dispose();
        node.material?.dispose();
      });
      this.root.clear();
    },
    set_robot(robot) {
      this.clear();
      this.robot = this.add_bodies(robot, false);
      this.ghost = this.add_bodies(robot, true);
      this.ball = null;
      if (robot.payload !== null) {
        const material = new THREE.MeshLambertMaterial({ color: PAYLOAD });
        this.ball = new THREE.Mesh(new THREE.SphereGeometry(robot.payload_radius, 24, 16), material);
        this.ball.visible = false;
        this.robot[robot.payload].add(this.ball);
      }
      const low = new THREE.Vector3(...robot.low);
      const high = new THREE.Vector3(...robot.high);
      const size = Math.max(...high.clone().sub(low).toArray());
      const grid = new THREE.GridHelper(3 * size, 12, 0x888888, 0x888888);
      grid.rotation.x = Math.PI / 2;
      grid.position.z = Math.min(low.z, 0);
      grid.material.transparent = true;
      grid.material.opacity = 0.35;
      this.root.add(grid);
      const middle = low.clone().add(high).multiplyScalar(0.5);
      this.controls?.target.copy(middle);
      this.camera.position.set(middle.x + 0.5 * size, middle.y - 1.6 * size, middle.z + 0.6 * size);
      this.controls?.update();
      this.request();
    },
    add_bodies(robot, is_ghost) {
      const bodies = robot.names.map(() => this.root.add(new THREE.Group()).children.at(-1));
      for (const shape of robot.shapes) {
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.BufferAttribute(floats(shape.vertices), 3));
        geometry.setIndex(new THREE.BufferAttribute(integers(shape.faces), 1));
        geometry.computeVertexNormals();
        const colour = is_ghost ? GHOST : `rgb(${shape.colour.join(",")})`;
        const see_through = is_ghost ? { transparent: true, opacity: 0.3, depthWrite: false } : { flatShading: false };
        const material = new THREE.MeshLambertMaterial({ color: colour, side: THREE.DoubleSide, ...see_through });
        bodies[shape.body].add(new THREE.Mesh(geometry, material));
      }
      return bodies;
    },
    set_run(run) {
      this.run = {
        step: run.step,
        robot: { positions: floats(run.positions), quaternions: floats(run.quaternions) },
        ghost: { positions: floats(run.ghost_positions), quaternions: floats(run.ghost_quaternions) },
        mass: floats(run.mass),
      };
      this.end = run.step * (this.run.mass.length - 1);
      this.time = Math.min(this.time, this.end);
      this.follow_curves();
      this.request();
    },
    toggle() {
      if (this.playing) return this.pause();
      this.playing = true;
      if (this.time >= this.end) this.time = 0;
      this.last = performance.now();
      const advance = (now) => {
        if (!this.playing || this.gone) return;
        if (now - this.last >= FRAME) {
          this.time = (this.time + Math.min(now - this.last, 200) / 1000) % (this.end || 1);
          this.last = now;
        }
        requestAnimationFrame(advance);
      };
      requestAnimationFrame(advance);
    },
    pause() {
      this.playing = false;
    },
    request() {
      if (this.waiting || !this.renderer) return;
      this.waiting = true;
      requestAnimationFrame(() => {
        this.waiting = false;
        if (!this.gone) this.draw();
      });
    },
    draw() {
      const canvas = this.renderer.domElement;
      const width = this.$el.clientWidth;
      const height = canvas.clientHeight;
      if (!width || !height) return;
      const ratio = Math.min(window.devicePixelRatio, 2);
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        this.renderer.setPixelRatio(ratio);
        this.renderer.setSize(width, height, false);
        this.camera.aspect = width / height;
        this.camera.updateProjectionMatrix();
      }
      this.pose();
      this.renderer.render(this.scene, this.camera);
      this.move_cursors();
    },
    pose() {
      if (!this.run) return;
      const last = this.run.mass.length - 1;
      const place = Math.min(this.time / this.run.step || 0, last);
      const frame = Math.min(Math.floor(place), Math.max(last - 1, 0));
      const next = Math.min(frame + 1, last);
      const between = place - frame;
      const first = new THREE.Vector3();
      const second = new THREE.Vector3();
      const turn = new THREE.Quaternion();
      for (const [bodies, poses] of [[this.robot, this.run.robot], [this.ghost, this.run.ghost]]) {
        const count = bodies.length;
        bodies.forEach((body, number) => {
          const a = frame * count + number;
          const b = next * count + number;
          first.fromArray(poses.positions, 3 * a);
          second.fromArray(poses.positions, 3 * b);
          body.position.lerpVectors(first, second, between);
          body.quaternion.fromArray(poses.quaternions, 4 * a);
          turn.fromArray(poses.quaternions, 4 * b);
          body.quaternion.slerp(turn, between);
        });
      }
      if (this.ball) this.ball.visible = this.run.mass[Math.round(place)] > 0;
    },
    follow_curves() {
      // hovering a curve shows the robot at that time
      for (const plot of document.querySelectorAll(this.curves)) {
        if (plot.followed === this.$el.id || !plot.on) continue;
        plot.followed = this.$el.id;
        plot.on("plotly_hover", (event) => {
          this.pause();
          this.time = Math.min(Math.max(event.points[0].x, 0), this.end);
        });
      }
    },
    move_cursors() {
      for (const plot of document.querySelectorAll(this.curves)) {
        const layout = plot._fullLayout;
        if (!layout?.xaxis?.l2p) continue;
        let cursor = plot.querySelector(".time-cursor");
        if (!cursor) {
          cursor = document.createElement("div");
          cursor.className = "time-cursor";
          plot.style.position = "relative";
          plot.appendChild(cursor);
        }
        const place = layout._size.l + layout.xaxis.l2p(this.time);
        cursor.style.transform = `translateX(${place}px)`;
        cursor.style.top = `${layout._size.t}px`;
        cursor.style.height = `${layout._size.h}px`;
      }
      this.follow_curves();
    },
  },
};
