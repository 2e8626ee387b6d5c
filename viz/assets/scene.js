// A 3D scene: its parts as triangles, its camera, and the component that shows it.
(function () {
  "use strict";
  const shared = () => window.meshtraceShaders; // scripts load in any order

  // Vectors and matrices by columns
  const sub = (a, b) => a.map((v, i) => v - b[i]);
  const add = (a, b, s = 1) => a.map((v, i) => v + s * b[i]);
  const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => a.map((v) => v / Math.sqrt(dot(a, a)));
  const times = (a, b) => Array.from({ length: 16 }, (_, k) =>
    [0, 1, 2, 3].reduce((sum, i) => sum + a[4 * i + (k & 3)] * b[(k & ~3) + i], 0));

  const FOV = (44 * Math.PI) / 180, HOME = { azimuth: -62, elevation: 18 };
  const LOWEST = 7; // elevation from which waves are still seen as a surface [deg]
  const TO_SUN = 203; // azimuth of the eye from that of the sun [deg]: its glint stands beside the link
  const ROOM = { x0: -0.86, x1: 0.93, y0: -0.88, y1: 0.82 }; // of the block in the window

  const eyeOf = (view) => {
    const a = (view.azimuth * Math.PI) / 180, e = (view.elevation * Math.PI) / 180;
    const away = [Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e)];
    return { away, right: [-Math.sin(a), Math.cos(a), 0], eye: add(view.focus, away, view.distance) };
  };
  const cameraOf = (view, aspect) => {
    const { away, right, eye } = eyeOf(view), up = cross(away, right), f = 1 / Math.tan(FOV / 2);
    const near = 0.02 * view.distance, far = 40 * view.distance, k = 1 / (near - far);
    const turn = [right[0], up[0], away[0], 0, right[1], up[1], away[1], 0, right[2], up[2], away[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(away, eye), 1];
    const lens = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) * k, -1, 0, 0, 2 * far * near * k, 0];
    // from the screen back to the world
    const un = [right, up, away], back = Array(16).fill(0);
    for (let i = 0; i < 3; i++) {
      back[i] = un[0][i] * aspect / f; back[4 + i] = un[1][i] / f;
      back[12 + i] = -un[2][i] + eye[i] * 1e-3; // at a distance of 1000, which keeps precision
    }
    back[15] = 1e-3;
    return { eye, away, matrix: times(lens, turn), back };
  };
  const framed = (stage, view, aspect) => {
    // By a fixed point, as perspective makes near corners stand further out.
    const [x, y] = stage.center, h = stage.half, corners = [];
    for (const i of [-h, h]) for (const j of [-h, h]) for (const z of [stage.bottom, stage.top]) corners.push([x + i, y + j, z]);
    let focus = [x, y, 0.5 * (stage.bottom + stage.top)], distance = 4 * h;
    const t = Math.tan(FOV / 2);
    for (let round = 0; round < 20; round++) {
      const { away, right } = eyeOf({ ...view, focus, distance }), up = cross(away, right), from = focus, spans = [];
      for (const [axis, low, high, scale] of [[right, ROOM.x0, ROOM.x1, aspect], [up, ROOM.y0, ROOM.y1, 1]]) {
        const seen = corners.map((c) => dot(sub(c, from), axis) / ((distance - dot(sub(c, from), away)) * t * scale));
        const least = Math.min(...seen), most = Math.max(...seen);
        spans.push((most - least) / (high - low));
        const shift = 0.5 * (least + most) - 0.5 * (low + high) * spans[spans.length - 1];
        focus = add(focus, axis, shift * distance * t * scale);
      }
      distance *= Math.max(...spans);
    }
    return { ...view, focus, distance };
  };

  const floats = (bytes) => new Float32Array(bytes.slice().buffer);

  // Triangles with normals: [points, normals]
  const Shape = () => {
    const points = [], normals = [];
    const triangle = (a, b, c) => {
      const n = cross(sub(b, a), sub(c, a));
      points.push(...a, ...b, ...c);
      normals.push(...n, ...n, ...n);
    };
    const basis = (up) => {
      const side = unit(cross(Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], up));
      return [side, cross(up, side), up];
    };
    const at = (center, [x, y, z], u, v, w) => center.map((c, i) => c + u * x[i] + v * y[i] + w * z[i]);
    return {
      points, normals,
      ring(center, up, inner, outer) {
        const axes = basis(up), n = 48;
        const rim = (r, k) => at(center, axes, r * Math.cos((2 * Math.PI * k) / n), r * Math.sin((2 * Math.PI * k) / n), 0);
        for (let k = 0; k < n; k++) {
          triangle(rim(inner, k), rim(outer, k), rim(outer, k + 1));
          if (inner > 0) triangle(rim(inner, k), rim(outer, k + 1), rim(inner, k + 1));
        }
      },
      box(center, up, [a, b, c], turn = 0) {
        const [x, y, z] = basis(up), co = Math.cos(turn), si = Math.sin(turn);
        const axes = [x.map((v, i) => co * v + si * y[i]), y.map((v, i) => co * v - si * x[i]), z];
        const p = (i, j, k) => at(center, axes, i * a, j * b, k * c);
        for (const s of [-1, 1]) {
          const quads = [[p(s, -1, -1), p(s, 1, -1), p(s, 1, 1), p(s, -1, 1)], [p(1, s, -1), p(-1, s, -1), p(-1, s, 1), p(1, s, 1)],
            [p(-1, -1, s), p(1, -1, s), p(1, 1, s), p(-1, 1, s)]];
          for (const [e, f, g, h] of quads) (s > 0 ? [[e, f, g], [e, g, h]] : [[e, g, f], [e, h, g]]).forEach((q) => triangle(...q));
        }
      },
      cone(apex, axis, half, length) {
        const axes = basis(axis), n = 72, r = length * Math.tan((half * Math.PI) / 180);
        const rim = (k) => at(apex, axes, r * Math.cos((2 * Math.PI * k) / n), r * Math.sin((2 * Math.PI * k) / n), length);
        for (let k = 0; k < n; k++) triangle(apex, rim(k), rim(k + 1));
      },
      drone(center, up, size, rotors) {
        const axes = basis(up), part = (x, y, z) => at(center, axes, x * size, y * size, z * size);
        const box = (x, y, z, half, turn = 0) => this.box(part(x, y, z), up, half.map((v) => v * size), turn);
        box(0, 0, 0.1, [0.1, 0.1, 0.1]); // payload
        box(0, 0, 0.3, [0.34, 0.24, 0.1]);
        box(0.02, 0, 0.42, [0.2, 0.15, 0.05]);
        for (const y of [-0.3, 0.3]) { // skids
          box(0, y, -0.12, [0.4, 0.025, 0.025]);
          for (const x of [-0.2, 0.2]) box(x, 0.9 * y, 0.06, [0.025, 0.025, 0.18]);
        }
        for (const k of [1, 3, 5, 7]) {
          const c = Math.cos((k * Math.PI) / 4), s = Math.sin((k * Math.PI) / 4);
          box(0.55 * c, 0.55 * s, 0.34, [0.5, 0.05, 0.04], (k * Math.PI) / 4);
          box(c, s, 0.42, [0.08, 0.08, 0.12]);
          box(c, s, 0.54, [0.5, 0.03, 0.012], (k * Math.PI) / 4 + 1.2); // seen edge-on, too
          rotors.ring(part(c, s, 0.54), up, 0, 0.52 * size);
        }
      },
    };
  };

  class Painter {
    // Programs and buffers of one canvas; `models` has the parts of the scenes by name.
    constructor(canvas) {
      const gl = (this.gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true }));
      if (!gl) throw new Error("this browser has no WebGL 2: the scene is left out");
      this.canvas = canvas;
      this.programs = {};
      for (const [name, sources] of Object.entries(shared().SHADERS)) this.programs[name] = this.program(sources);
      this.models = {};
      gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    }
    program(sources) {
      const gl = this.gl, made = gl.createProgram();
      [gl.VERTEX_SHADER, gl.FRAGMENT_SHADER].forEach((kind, i) => {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, sources[i]);
        gl.compileShader(shader);
        gl.attachShader(made, shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      });
      gl.linkProgram(made);
      if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
      const uniforms = {};
      for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); i++) {
        const { name, type } = gl.getActiveUniform(made, i);
        uniforms[name.replace("[0]", "")] = { type, where: gl.getUniformLocation(made, name) };
      }
      return { made, uniforms };
    }
    buffer(data, kind = this.gl.ARRAY_BUFFER) {
      const gl = this.gl, made = gl.createBuffer();
      gl.bindVertexArray(null);
      gl.bindBuffer(kind, made);
      gl.bufferData(kind, data, gl.STATIC_DRAW);
      return made;
    }
    texture(bytes, width, height, across, mipmaps) {
      const gl = this.gl, made = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, made);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, across ? gl.REPEAT : gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, mipmaps ? gl.REPEAT : gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, mipmaps ? gl.LINEAR_MIPMAP_LINEAR : gl.LINEAR);
      if (mipmaps) {
        gl.generateMipmap(gl.TEXTURE_2D);
        const more = gl.getExtension("EXT_texture_filter_anisotropic");
        if (more) gl.texParameterf(gl.TEXTURE_2D, more.TEXTURE_MAX_ANISOTROPY_EXT, 4);
      }
      return made;
    }
    take(which, parts) {
      // Replace parts of a scene; those of the former are freed with it.
      const m = (this.models[which] ??= {});
      const shape = (s) => ({ points: this.buffer(new Float32Array(s.points)), normals: this.buffer(new Float32Array(s.normals)), n: s.points.length / 3 });
      if (parts.faces) m.faces = { buffer: this.buffer(parts.faces.slice(), this.gl.ELEMENT_ARRAY_BUFFER), n: parts.faces.length / 4 };
      if (parts.stage) m.stage = parts.stage;
      if (parts.sea) {
        if (m.sea) Object.values(m.sea).forEach((b) => this.gl.deleteBuffer(b));
        m.sea = { points: this.buffer(floats(parts.sea.points)), normals: this.buffer(floats(parts.sea.normals)),
          ...(parts.sea.tints && { tints: this.buffer(floats(parts.sea.tints)) }) };
        m.ring = floats(parts.sea.ring);
      }
      if (parts.sea || parts.stage) {
        const sides = [], n = m.ring.length / 3;
        for (let i = 0; i < n; i++) {
          const [a, b] = [i, (i + 1) % n].map((k) => [...m.ring.subarray(3 * k, 3 * k + 3)]);
          const [c, d] = [a, b].map(([x, y]) => [x, y, m.stage.bottom, 0]);
          for (const corner of [a, c, b, b, c, d]) sides.push(...(corner.length < 4 ? [...corner, 1] : corner)); // anticlockwise from outside
        }
        // the cut through a wave that hangs over comes as triangles
        const cut = parts.sea?.sides ? floats(parts.sea.sides) : new Float32Array(sides);
        m.sides = { buffer: this.buffer(cut), n: cut.length / 4 };
      }
      if (parts.look) {
        const l = (m.look = parts.look);
        if (l.waves.bytes) m.waves = this.texture(l.waves.bytes, l.waves.n, l.waves.n, true, true);
        m.sky = this.texture(l.sky.bytes, 32, 16, true, false);
      }
      if (parts.link) {
        m.link = parts.link;
        const size = parts.link.size, view = Shape(), disk = Shape(), uav = Shape(), rotors = Shape();
        for (const r of parts.link.receivers) {
          const sight = r.axis.map((v) => -v), r0 = Math.max(r.radius, 0.014 * size);
          const length = (1.15 * Math.abs(r.place[2]) + 0.02 * size) / Math.max(Math.abs(sight[2]), 0.2);
          if (r.half < 80) view.cone(r.place, sight, r.half, length);
          disk.ring(r.place, r.axis, 0, r0);
        }
        for (const [place, up] of parts.link.carried) uav.drone(place, up, 0.055 * size, rotors);
        Object.assign(m, { view: shape(view), disk: shape(disk), uav: shape(uav), rotors: shape(rotors) });
      }
      if (parts.bodies) {
        for (const b of m.bodies ?? []) [b.points, b.normals].forEach((buffer) => this.gl.deleteBuffer(buffer));
        m.bodies = parts.bodies.map(({ bytes, color }) => {
          const points = floats(bytes), normals = new Float32Array(points.length);
          for (let i = 0; i < points.length; i += 9) {
            const [a, b, c] = [i, i + 3, i + 6].map((k) => points.subarray(k, k + 3)), n = cross(sub(b, a), sub(c, a));
            for (let k = i; k < i + 9; k += 3) normals.set(n, k);
          }
          return { ...shape({ points, normals }), color };
        });
      }
      if (parts.dots) m.dots = { buffer: this.buffer(floats(parts.dots)), n: parts.dots.length / 12 };
      if (parts.rays !== undefined) m.rays = { buffer: this.buffer(floats(parts.rays)), n: parts.rays.length / 28 };
      if (parts.map !== undefined) m.map = parts.map && { ...parts.map, image: this.texture(parts.map.bytes, parts.map.n, parts.map.n, false, false) };
      if (parts.time !== undefined) m.time = parts.time;
    }
    use(name, values) {
      const gl = this.gl, { made, uniforms } = this.programs[name];
      gl.useProgram(made);
      for (const [key, { type, where }] of Object.entries(uniforms)) {
        const v = values[key];
        if (v === undefined) continue;
        if (type === gl.FLOAT) gl.uniform1f(where, v);
        else if (type === gl.INT || type === gl.SAMPLER_2D) gl.uniform1i(where, v);
        else if (type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(where, false, v);
        else gl[{ [gl.FLOAT_VEC2]: "uniform2fv", [gl.FLOAT_VEC3]: "uniform3fv", [gl.FLOAT_VEC4]: "uniform4fv" }[type]](where, v);
      }
      return made;
    }
    bind(made, fields, every = 0) {
      const gl = this.gl;
      for (let i = 0; i < 4; i++) { gl.disableVertexAttribArray(i); gl.vertexAttribDivisor(i, 0); }
      for (const [name, buffer, size, stride, offset] of fields) {
        const at = gl.getAttribLocation(made, name);
        if (at < 0) continue;
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, stride, offset);
        gl.vertexAttribDivisor(at, every);
      }
    }
    begin(smooth) {
      // Draw with smooth edges, which take twice the time without a GPU, until `end`.
      const gl = this.gl, { width, height } = this.canvas;
      if (!smooth) return;
      this.target ??= { frame: gl.createFramebuffer(), color: gl.createRenderbuffer(), depth: gl.createRenderbuffer() };
      const { frame, color, depth } = this.target, samples = Math.min(4, gl.getParameter(gl.MAX_SAMPLES));
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      for (const [buffer, format, at] of [[color, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        if (this.target.size !== `${width} ${height}`) gl.renderbufferStorageMultisample(gl.RENDERBUFFER, samples, format, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, at, gl.RENDERBUFFER, buffer);
      }
      this.target.size = `${width} ${height}`;
    }
    end() {
      const gl = this.gl, { width, height } = this.canvas;
      if (!gl.getParameter(gl.FRAMEBUFFER_BINDING)) return;
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
      gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    }
    draw(which, view, [x, y, w, h], ratio) {
      const gl = this.gl, m = this.models[which];
      if (!m?.link || !m.sea || !m.look) return;
      const { eye, away, matrix, back } = cameraOf(view, w / h), l = m.look, s = m.stage, lamps = m.link.lamps;
      const level = Math.hypot(away[0], away[1]) || 1;
      const pad = (key) => Array.from({ length: shared().LAMPS }, (_, i) => lamps[i]?.[key] ?? [0, 0, 0, 0]).flat();
      const all = {
        eye, back, camera: matrix, sky: 0, waves: 1, image: 2, ahead: [-away[0] / level, -away[1] / level],
        sun: l.sun, tint: l.tint, inside: l.inside, upwelling: l.upwelling, absorption: l.absorption, rest: l.rest, wind: l.wind,
        skyScale: [l.sky.scale, 0], sunShare: l.direct, foam: l.foam, steepness: l.steepness, height: l.height,
        waveSize: l.waves.size, waveScale: l.waves.scale, time: m.time ?? 0, index: m.link.index, extinction: m.link.extinction,
        scattering: m.link.scattering, loss: m.link.loss,
        beam: m.link.color, middle: s.center, halfWidth: s.half, bottom: s.bottom, top: s.top, lamps: Math.min(lamps.length, shared().LAMPS),
        place: pad("place"), axis: pad("axis"), shape: pad("shape"), plane: m.link.plane, norm: m.link.norm, pixels: [w, h],
      };
      gl.viewport(x, y, w, h);
      gl.scissor(x, y, w, h);
      gl.enable(gl.SCISSOR_TEST);
      gl.clear(gl.DEPTH_BUFFER_BIT | gl.COLOR_BUFFER_BIT);
      [m.sky, m.waves].forEach((t, i) => { gl.activeTexture(gl.TEXTURE0 + i); gl.bindTexture(gl.TEXTURE_2D, t); });
      gl.disable(gl.BLEND);
      gl.disable(gl.DEPTH_TEST);
      this.bind(this.use("sky", all), []);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 3);
      gl.enable(gl.CULL_FACE);
      this.bind(this.use("block", all), [["corner", m.sides.buffer, 4, 0, 0]]);
      gl.drawArrays(gl.TRIANGLES, 0, m.sides.n);
      gl.disable(gl.CULL_FACE);
      gl.enable(gl.DEPTH_TEST);
      const sea = [["point", m.sea.points, 3, 0, 0], ["normal", m.sea.normals, 3, 0, 0]];
      const facets = () => {
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, m.faces.buffer);
        gl.drawElements(gl.TRIANGLES, m.faces.n, gl.UNSIGNED_INT, 0);
      };
      if (m.sea.tints) this.bind(this.use("tinted", all), [...sea, ["tint", m.sea.tints, 3, 0, 0]]);
      else this.bind(this.use("sea", all), sea);
      facets();
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      const solid = (part, color, lit, side = 0) => {
        this.bind(this.use("plain", { ...all, color, lit, side }), [["point", part.points, 3, 0, 0], ["normal", part.normals, 3, 0, 0]]);
        gl.drawArrays(gl.TRIANGLES, 0, part.n);
      };
      for (const b of m.bodies ?? []) solid(b, [...b.color, 1], 1);
      solid(m.uav, [0.55, 0.58, 0.61, 1], 1);
      gl.depthMask(false);
      solid(m.rotors, [0.75, 0.8, 0.85, 0.12], 0);
      if (m.dots?.n) {
        this.bind(this.use("dots", { ...all, size: ratio }), [["point", m.dots.buffer, 3, 0, 0]]);
        gl.drawArrays(gl.POINTS, 0, m.dots.n);
      }
      if (m.link.norm > 0 && !m.map && !m.sea.tints) {
        const [lamp] = lamps, first = (v) => [...v, ...Array(4 * (shared().LAMPS - 1)).fill(0)];
        const own = { place: first([...lamp.at, lamp.place[3]]), axis: first(lamp.own.axis), shape: first(lamp.own.shape) };
        this.bind(this.use("focus", { ...all, ...own }), sea);
        facets();
      }
      if (m.map) {
        gl.activeTexture(gl.TEXTURE2);
        gl.bindTexture(gl.TEXTURE_2D, m.map.image);
        this.bind(this.use("map", { ...all, box: m.map.box }), []);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      }
      solid(m.view, [...m.link.colors.receiver, 0.085], 0, Math.sign(m.link.plane));
      if (m.rays?.n) {
        const at = [["start", m.rays.buffer, 3, 28, 0], ["end", m.rays.buffer, 3, 28, 12], ["kind", m.rays.buffer, 1, 28, 24]];
        const ink = { ...all, colors: m.link.colors.rays.flat(), width: 1.2 * ratio, alpha: 0.4, faint: 0.25 };
        this.bind(this.use("line", ink), at, 1);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, m.rays.n);
      }
      gl.depthMask(true);
      solid(m.disk, [...m.link.colors.receiver, 1], 0);
      for (const [faint, test] of [[0.35, gl.GREATER], [1, gl.LESS]]) { // a lamp behind the sea is seen through it
        gl.depthFunc(test);
        for (const lamp of lamps) {
          this.bind(this.use("lamp", { ...all, center: lamp.at, color: m.link.color, size: 46 * ratio, faint }), []);
          gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
        }
      }
      gl.disable(gl.SCISSOR_TEST);
    }
  }

  const Scene = {
    // The scene, and beside it the one kept for comparison; drag or arrow keys turn it.
    props: { label: String, caption: String },
    data: () => ({ view: null, stage: null, wind: [1, 0], two: false, problem: "", w: 600, h: 400 }),
    created() { Object.assign(this, { pointers: new Map(), share: 1, rest: 0 }); },
    mounted() {
      try {
        this.painter = Vue.markRaw(new Painter(this.$refs.canvas));
      } catch (error) {
        this.problem = error.message;
      }
      this.watcher = new ResizeObserver(() => {
        this.w = this.$el.clientWidth || this.w;
        this.h = this.$el.clientHeight || this.h;
        if (this.untouched) this.home();
        this.redraw();
      });
      this.watcher.observe(this.$el);
      this.$refs.canvas.addEventListener("wheel", this.wheel, { passive: false });
      this.$emit("ready");
    },
    unmounted() {
      this.watcher.disconnect();
      clearTimeout(this.rest);
      cancelAnimationFrame(this.due);
    },
    emits: ["ready", "drawn"],
    computed: {
      aspect() { return this.w / (this.two ? 2 : 1) / this.h; },
      gizmo() {
        if (!this.view) return [];
        const { away, right } = eyeOf(this.view), up = cross(away, right);
        const axes = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1], wind: [...this.wind, 0] };
        return Object.entries(axes).map(([name, v]) => ({ name, x: 24 * dot(v, right), y: -24 * dot(v, up) }));
      },
      ruler() {
        // Marks of z on a pole at the left of the block, of state B where two are compared. It stands as
        // far away as the lamp: marks at another distance would read 13 to 21 % wrong in perspective.
        if (!this.view || !this.stage) return [];
        const { center: [x, y], half: h, bottom, pole } = this.stage, left = this.two ? this.w / 2 : 0;
        // right is level: all that it leads to from the lamp is at one height of the picture
        const [rx, ry] = eyeOf(this.view).right, corners = [[-h, -h], [-h, h], [h, -h], [h, h]];
        const aside = Math.min(...corners.map(([i, j]) => (x + i - pole[0]) * rx + (y + j - pole[1]) * ry));
        const edge = [pole[0] + aside * rx, pole[1] + aside * ry];
        const steps = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000], marks = [];
        // a label is 16 px high, and perspective shortens the lower steps; two marks at least
        const most = Math.min(4.5, Math.abs(this.onScreen([...edge, bottom])[1] - this.onScreen([...edge, 0])[1]) / 20);
        const step = Math.min(steps.find((v) => -bottom / v <= most) ?? 2000, steps.findLast((v) => v <= -bottom) ?? 0.1);
        for (let z = 0; z >= bottom - 1e-9; z -= step) marks.push({ z: Number(z.toFixed(2)), at: this.onScreen([...edge, z]) });
        const side = marks.some((m) => m.at[0] < left + 40) ? 1 : -1; // within the block where there is no room beside it
        return marks.map((m) => ({ ...m, side })).filter(({ at: [u, v] }) => u > left && u < this.w && v > 60 && v < this.h - 30);
      },
    },
    methods: {
      onScreen(p) {
        // Place of a point on the screen [px], in state B where two are compared; far off behind the eye.
        const { matrix } = cameraOf(this.view, this.aspect), wide = this.two ? this.w / 2 : this.w;
        const q = [0, 1, 3].map((i) => matrix[i] * p[0] + matrix[4 + i] * p[1] + matrix[8 + i] * p[2] + matrix[12 + i]);
        return q[2] > 0 ? [this.w - wide + ((q[0] / q[2] + 1) / 2) * wide, ((1 - q[1] / q[2]) / 2) * this.h] : [1e4, 1e4];
      },
      show(parts) {
        if (!this.painter || !(this.stage || parts.stage)) return; // a running sea before the whole scene
        this.painter.take("now", parts);
        this.owed = true;
        if (parts.look) {
          const { wind, sun, direct } = parts.look, azimuth = direct > 0 ? (Math.atan2(sun[1], sun[0]) * 180) / Math.PI + TO_SUN : HOME.azimuth;
          this.wind = wind;
          if (azimuth !== this.azimuth && this.untouched) this.turned = true;
          this.azimuth = azimuth;
        }
        if (parts.stage) {
          const again = !this.stage || parts.stage.framing !== this.stage.framing;
          this.stage = parts.stage;
          if (again) this.home();
          else if (this.view) this.view = { ...this.view };
        }
        if (this.turned) this.home();
        this.redraw();
      },
      keep(parts) {
        // Show parts of another state at the left; none ends the comparison.
        this.two = Boolean(parts);
        if (parts) this.painter?.take("kept", parts);
        if (this.untouched) this.home();
        this.redraw();
      },
      home() {
        if (!this.stage) return;
        Object.assign(this, { untouched: true, turned: false });
        // low enough for the lamp to stand below the near edge of the sea
        const below = (Math.atan((0.75 * (this.stage.deep ?? Infinity)) / this.stage.half) * 180) / Math.PI;
        const elevation = Math.min(Math.max(below, LOWEST), HOME.elevation);
        this.view = framed(this.stage, { elevation, azimuth: this.azimuth ?? HOME.azimuth }, this.aspect);
        this.redraw();
      },
      move(change) {
        if (!this.view) return;
        this.untouched = false;
        const v = { ...this.view };
        v.azimuth += change.azimuth ?? 0;
        v.elevation = Math.min(Math.max(v.elevation + (change.elevation ?? 0), 2), 89);
        v.distance = Math.min(Math.max(v.distance * (change.zoom ?? 1), 0.6 * this.stage.half), 30 * this.stage.half);
        this.view = v;
        this.redraw();
      },
      start(event) {
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
        event.currentTarget.setPointerCapture(event.pointerId);
      },
      drag(event) {
        const before = this.pointers.get(event.pointerId);
        if (!before) return;
        const span = () => { const [a, b] = [...this.pointers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]) || 1; };
        const was = this.pointers.size === 2 ? span() : 0;
        this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
        if (was) this.move({ zoom: was / span() });
        else this.move({ azimuth: -0.35 * (event.clientX - before[0]), elevation: 0.35 * (event.clientY - before[1]) });
      },
      stop(event) { this.pointers.delete(event.pointerId); },
      wheel(event) { event.preventDefault(); this.move({ zoom: Math.exp(0.0012 * event.deltaY) }); },
      key(event) {
        const keys = { ArrowLeft: { azimuth: 5 }, ArrowRight: { azimuth: -5 }, ArrowUp: { elevation: 3 }, ArrowDown: { elevation: -3 },
          "+": { zoom: 0.9 }, "=": { zoom: 0.9 }, "-": { zoom: 1.1 } };
        if (event.key === "Home") this.home();
        else if (keys[event.key]) this.move(keys[event.key]);
        else return;
        event.preventDefault();
      },
      redraw() {
        // Without a fast GPU at lower resolution first, at the full one when all rests.
        if (this.due || !this.painter) return;
        this.due = requestAnimationFrame(() => {
          const full = Math.min(window.devicePixelRatio || 1, 2), gl = this.painter.gl, begun = performance.now();
          this.due = 0;
          this.paint(full * this.share, this.share === 1);
          gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // ends with the drawing
          if (this.owed) this.$emit("drawn");
          this.owed = false;
          const cost = (performance.now() - begun) / (this.share * this.share);
          this.share = Math.min(Math.max(Math.sqrt(40 / cost), 0.4), 1);
          clearTimeout(this.rest);
          if (this.share < 1) this.rest = setTimeout(() => this.paint(full), 400);
        });
      },
      paint(ratio, smooth = true) {
        if (!this.view) return;
        const canvas = this.$refs.canvas, w = Math.round(this.w * ratio), h = Math.round(this.h * ratio);
        if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
        const half = Math.floor(w / 2);
        this.painter.begin(smooth);
        if (this.two) this.painter.draw("kept", this.view, [0, 0, half, h], ratio);
        this.painter.draw("now", this.view, this.two ? [half, 0, w - half, h] : [0, 0, w, h], ratio);
        this.painter.end();
      },
      save() {
        // A picture of twice the size, without marks and buttons, with the caption below it.
        const ratio = 2 * Math.min(window.devicePixelRatio || 1, 2), shot = this.$refs.canvas;
        this.paint(ratio);
        const size = Math.max(Math.round(shot.width / 64), 14), canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
        canvas.width = shot.width;
        canvas.height = shot.height + Math.round(2.8 * size);
        pen.fillStyle = "#ffffff";
        pen.fillRect(0, 0, canvas.width, canvas.height);
        pen.drawImage(shot, 0, 0);
        pen.fillStyle = "#1f2933";
        pen.font = `${size}px system-ui, sans-serif`;
        pen.fillText(this.caption, size, shot.height + 1.75 * size, canvas.width - 2 * size);
        this.redraw();
        const link = document.createElement("a");
        link.download = "meshtrace.png";
        link.href = canvas.toDataURL("image/png");
        link.click();
      },
    },
    template: `
      <div class="mt-stage">
        <canvas ref="canvas" tabindex="0" role="application" :aria-label="label" @pointerdown="start" @pointermove="drag"
          @pointerup="stop" @pointercancel="stop" @keydown="key" @dblclick="home"></canvas>
        <p v-if="problem" class="mt-problem" role="alert">{{ problem }}</p>
        <svg class="mt-over" aria-hidden="true">
          <line v-if="ruler.length > 1" id="pole" :x1="ruler[0].at[0]" :y1="ruler[0].at[1]"
            :x2="ruler[ruler.length - 1].at[0]" :y2="ruler[ruler.length - 1].at[1]" />
          <g v-for="m in ruler" :key="m.z"><line :x1="m.at[0]" :x2="m.at[0] + (m.side < 0 ? -6 : 3)" :y1="m.at[1]" :y2="m.at[1]" />
            <text :x="m.at[0] + 9 * m.side" :y="m.at[1] + 4" :text-anchor="m.side < 0 ? 'end' : 'start'">{{ m.z === 0 ? "0 m" : "−" + -m.z }}</text></g>
          <g :transform="'translate(' + (w - 46) + ',' + (h - 62) + ')'" class="mt-gizmo">
            <g v-for="a in gizmo" :key="a.name" :class="'mt-' + a.name" :transform="a.name !== 'wind' ? '' : w < 500 ? 'translate(-2,-78)' : 'translate(-64,12)'">
              <line :x1="a.name === 'wind' ? -a.x : 0" :y1="a.name === 'wind' ? -a.y : 0" :x2="a.x" :y2="a.y" />
              <circle v-if="a.name === 'wind'" :cx="a.x" :cy="a.y" r="3.5" />
              <text v-if="a.name === 'wind'" y="26" text-anchor="middle">wind</text>
              <text v-else :x="1.4 * a.x" :y="1.4 * a.y + 4" text-anchor="middle">{{ a.name }}</text></g>
          </g>
          <g v-if="two" class="mt-halves"><line :x1="w / 2" :x2="w / 2" y1="0" :y2="h" />
            <text :x="w / 2 - 12" y="24" text-anchor="end">A</text><text :x="w / 2 + 12" y="24">B</text></g>
        </svg>
      </div>`,
  };

  window.meshtraceScene = Scene;
})();
