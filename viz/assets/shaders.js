// Shaders of the scene: water, sky and light for each pixel by WebGL 2.
(function () {
  "use strict";
  const LAMPS = 4;

  // What a viewer sees of water, sky and beams, in the terms of meshtrace.viz.water: radiance over
  // that of a white, level surface, by 1 - exp(-4.2 L) and the sRGB curve to the screen.
  const LIGHT = `#version 300 es
    precision highp float;
    const float PI = 3.14159265;
    uniform vec3 eye, sun, tint, inside, upwelling, absorption, beam;
    uniform sampler2D sky, waves;
    uniform vec2 rest, wind, skyScale;
    uniform float sunShare, foam, time, waveSize, waveScale, steepness, index, extinction, scattering, loss;
    uniform vec2 middle;
    uniform float halfWidth, bottom;
    uniform int lamps;
    uniform vec4 place[${LAMPS}], axis[${LAMPS}], shape[${LAMPS}];
    out vec4 shade;

    vec3 screen(vec3 light) {
      vec3 exposed = 4.2 * max(light, 0.0), linear = exposed / (1.0 + exposed);
      return mix(12.92 * linear, 1.055 * pow(linear, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, linear));
    }
    vec3 skyLight(vec3 d) {
      float up = clamp(asin(clamp(d.z, 0.0, 1.0)) / (0.5 * PI), 0.0, 1.0);
      vec3 root = texture(sky, vec2(atan(d.y, d.x) / (2.0 * PI), (0.5 + 15.0 * sqrt(up)) / 16.0)).rgb;
      return skyScale.x * root * root * tint;
    }
    float pattern(vec3 d, int i) { // intensity over that on the axis
      float c = dot(normalize(d), axis[i].xyz);
      return shape[i].x > 0.0 ? pow(max(c, 1e-4), shape[i].x) : smoothstep(axis[i].w - 0.004, axis[i].w, c);
    }
    // Light of a beam per volume, over that at a third of its way; shape: power of the cosine,
    // tangent of the drawn half angle, reference distance, brightness; place.w: lamp in the air.
    // Light scattered forwards widens as in small angles, and is lost to absorption and wide angles.
    float wider(float path, int i) { // square of the widening
      float narrow = min(shape[i].y, 2.0);
      return 1.0 + 0.2 * scattering * path / (narrow * narrow);
    }
    float glow(vec3 p, int i) {
      vec3 d = p - place[i].xyz;
      float r2 = dot(d, d), r = sqrt(r2), ref = shape[i].z, along = dot(d, axis[i].xyz);
      float path = place[i].w > 0.5 ? -min(p.z, 0.0) * r / max(place[i].z - p.z, 1e-3) : r;
      float straight = exp(-extinction * path), wide = wider(path, i);
      float off = (r2 / max(along * along, 1e-6) - 1.0) / (shape[i].y * shape[i].y * wide);
      float strayed = along > 0.0 ? max(exp(-loss * path) - straight, 0.0) * exp(-3.5 * off) / wide : 0.0;
      return shape[i].w * (pattern(d, i) * straight + strayed) * ref * ref / (r2 + 0.003 * ref * ref);
    }
    vec3 beams(vec3 from, vec3 d, float most) { // sum along a way in the water
      float sum = 0.0;
      for (int i = 0; i < lamps; i++) {
        vec3 w = from - place[i].xyz, v = axis[i].xyz;
        float b = dot(d, v), e = dot(v, w), q = dot(d, w), spread = shape[i].y, ref = shape[i].z;
        float s = clamp((e - b * q) / max(1.0 - b * b, 0.02), 0.0, 20.0 * ref);
        float t = dot(place[i].xyz + s * v - from, d), broad = spread * sqrt(wider(s, i));
        float reach = s * broad + 0.12 * ref * min(spread, 1.0);
        if (length(w + t * d - s * v) > 1.02 * reach + 1e-6) continue;
        float wide = 1.6 * reach / sqrt(max(1.0 - b * b, 0.06));
        vec2 ends = clamp((vec2(max(t - wide, 0.0), min(t + wide, most)) - t) / wide, -1.0, 1.0);
        ends = sign(ends) * sqrt(abs(ends)); // steps are fine near the axis
        if (ends.y <= ends.x) continue;
        float step = (ends.y - ends.x) / 12.0, part = 0.0;
        for (int k = 0; k < 12; k++) {
          float u = ends.x + (float(k) + 0.5) * step;
          vec3 p = from + (t + wide * u * abs(u)) * d;
          part += p.z < 0.0 ? 2.0 * wide * abs(u) * glow(p, i) : 0.0;
        }
        sum += part * step / (ref * min(spread, 2.0));
      }
      return beam * sum;
    }
    float leave(vec3 p, vec3 d) { // way to the sides or the floor of the block
      vec2 side = (halfWidth * sign(d.xy) + middle - p.xy) / (abs(d.xy) + 1e-6) * sign(d.xy + 1e-9);
      float floorAt = d.z < 0.0 ? (bottom - p.z) / d.z : (0.0 - p.z) / max(d.z, 1e-6);
      return max(min(min(side.x, side.y), floorAt), 0.0);
    }
    vec3 below(float z) { return 1.8 * inside * upwelling * (0.2 + 0.8 * exp(1.2 * absorption * min(z, 0.0))); }

    vec3 ripple(vec2 p, float scale, float turn, float speed) { // slopes and their square
      float c = cos(turn), s = sin(turn);
      vec2 at = mat2(c, -s, s, c) * (p - speed * time * wind) / (waveSize * scale);
      vec3 found = texture(waves, at).rgb;
      vec2 slope = (found.rg - 0.502) * 2.0 * waveScale;
      return vec3(mat2(c, s, -s, c) * slope, found.b * waveScale * waveScale);
    }
    vec3 water(vec3 p, vec2 slope, float more, float crest, bool lit) {
      vec3 r1 = ripple(p.xy, 1.0, 0.0, 0.6), r2 = ripple(p.xy, 0.37, 0.47, 0.35);
      vec2 fine = 0.75 * r1.xy + 0.66 * r2.xy;
      float lost = 0.56 * max(r1.z - dot(r1.xy, r1.xy), 0.0) + 0.44 * max(r2.z - dot(r2.xy, r2.xy), 0.0);
      slope += fine;
      vec2 spread = max(rest + 0.5 * (lost + more), vec2(2e-4));
      vec3 n = normalize(vec3(-slope, 1.0)), v = normalize(eye - p);
      float sigma = sqrt(spread.x + spread.y);
      float facing = clamp(dot(v, n), 0.02, 1.0), c = clamp(facing + 0.35 * sigma * (1.0 - facing), 0.02, 1.0);
      vec3 mirrored = 2.0 * dot(v, n) * n - v;
      mirrored.z = abs(mirrored.z) + 0.6 * sigma * (1.0 - c);
      float g = sqrt(index * index - 1.0 + c * c), a = (g - c) / (g + c), b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0);
      float rho = clamp(0.5 * a * a * (1.0 + b * b), 0.0, 1.0);
      vec3 light = rho * skyLight(normalize(mirrored));
      if (sunShare > 0.0) { // as Cox and Munk (1954)
        vec3 h = normalize(v + sun);
        vec2 d = -h.xy / max(h.z, 0.05) - slope;
        vec2 u = vec2(dot(d, wind), wind.x * d.y - wind.y * d.x);
        float density = exp(-0.5 * (u.x * u.x / spread.x + u.y * u.y / spread.y)) / (2.0 * PI * sqrt(spread.x * spread.y));
        vec3 glint = rho * density / (4.0 * pow(h.z, 4.0) * facing) * PI * sunShare * tint * vec3(1.0, 0.96, 0.88);
        light += glint / (1.0 + glint / 0.4); // of which a film would keep the colour
      }
      light += (1.0 - rho) * tint * upwelling * (1.0 + 0.35 * clamp(crest, -1.5, 2.0));
      if (lit) {
        vec3 into = refract(-v, n, 1.0 / index);
        light += (1.0 - rho) * beams(p, into, leave(p, into));
        for (int i = 0; i < lamps; i++) // where it crosses the waves
          light += (place[i].w > 0.5 ? 0.3 : 0.9) * (1.0 - 0.6 * rho) * beam * glow(vec3(p.xy, -1e-3), i);
      }
      float streaks = texture(waves, p.xy / (4.0 * waveSize) - 0.03 * wind * time / waveSize).a * 8.0 - 4.0;
      float white = clamp(0.5 + (streaks + 0.5 * crest - foam) / 0.9, 0.0, 1.0);
      // for looks: at night as bright as the sky that grazing waves mirror, or it would be dark
      vec3 froth = max(0.5 * tint, 1.5 * skyLight(normalize(vec3(-v.xy, 0.1))));
      return mix(light, froth, white);
    }`;

  const SHADERS = {
    sky: [`#version 300 es
      out vec2 at;
      void main() { at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0; gl_Position = vec4(at, 0.999, 1.0); }`,
      `${LIGHT}
      in vec2 at;
      uniform mat4 back;
      uniform vec2 ahead;
      void main() {
        vec4 far = back * vec4(at, 1.0, 1.0);
        vec3 d = normalize(far.xyz / far.w - eye), light = skyLight(d);
        light = max(1.1 * mix(vec3(dot(light, vec3(0.3, 0.5, 0.2))), light, 1.5), 0.0);
        light /= 1.0 + 1.2 * light; // for looks, as the richer colours: bright skies stay blue
        float disc = smoothstep(0.99985, 0.99992, dot(d, sun));
        light += disc * min(sunShare * 8.0, 3.0) * tint;
        if (d.z < 0.0) {
          vec3 p = eye - d * eye.z / d.z;
          float away = length(p.xy - eye.xy), beyond = dot(p.xy - middle, ahead) / halfWidth;
          float shown = smoothstep(-0.2, 1.1, beyond);
          vec3 sea = vec3(0.0);
          if (shown > 0.0) { // the longest of the waves as wide as half the block
            vec3 swell = ripple(p.xy, 2.0 * halfWidth / waveSize, 0.0, 1.0) * sqrt(8.0 * steepness) / waveScale;
            sea = water(p, swell.xy, steepness - dot(swell.xy, swell.xy), 0.0, false);
            sea = mix(sea, light, smoothstep(0.5, 1.0, 1.0 - exp(-away / (70.0 * halfWidth))));
          }
          vec3 deep = below(0.35 * bottom) * mix(0.8, 0.4, smoothstep(0.05, 0.5, -d.z));
          light = mix(deep, sea, shown);
        }
        shade = vec4(screen(light), 1.0);
      }`],
    block: [`#version 300 es
      in vec4 corner; // place, and 1 at the waves, 0 at the floor
      uniform mat4 camera;
      out vec4 p;
      void main() { p = corner; gl_Position = camera * vec4(corner.xyz, 1.0); }`,
      `${LIGHT}
      in vec4 p;
      void main() {
        vec3 d = normalize(p.xyz - eye);
        float way = leave(p.xyz, d);
        vec3 light = below(p.z) * (0.75 + 0.25 * exp(-way / (2.0 * halfWidth)));
        light += beams(p.xyz, d, way);
        if (sunShare > 0.0) { // sunlight that the waves gather, along its way into the water
          vec3 down = refract(-sun, vec3(0.0, 0.0, 1.0), 1.0 / index), shafts = vec3(0.0);
          float reach = min(way, halfWidth);
          for (int k = 0; k < 6; k++) {
            vec3 q = p.xyz + (float(k) + 0.5) / 6.0 * reach * d;
            float from = textureLod(waves, (q.xy - down.xy * q.z / down.z) / (2.5 * halfWidth), 2.0).a * 8.0 - 4.0;
            shafts += exp(1.5 * absorption * q.z + max(from, -2.0));
          }
          light += 0.06 * inside * upwelling * sunShare * shafts * reach / halfWidth;
        }
        float edge = (1.0 - p.w) / max(fwidth(p.w), 1e-6);
        light += (0.015 + 0.8 * inside * upwelling) * (1.0 - smoothstep(0.6, 2.2, edge));
        shade = vec4(screen(light), 1.0);
      }`],
    sea: [`#version 300 es
      in vec3 point, normal;
      uniform mat4 camera;
      uniform float height;
      out vec3 p, n;
      out float crest;
      void main() { p = point; n = normal; crest = point.z / height; gl_Position = camera * vec4(point, 1.0); }`,
      `${LIGHT}
      in vec3 p, n;
      in float crest;
      void main() {
        if (any(greaterThan(abs(p.xy - middle), vec2(1.0001 * halfWidth)))) discard;
        shade = vec4(screen(water(p, -n.xy / max(n.z, 0.2), 0.0, crest, true)), 1.0);
      }`],
    // Light of the first lamp bent by the waves onto the plane of the aperture, by the areas of the
    // facets before and after.
    focus: [`#version 300 es
      in vec3 point, normal;
      uniform mat4 camera;
      uniform vec4 place[${LAMPS}];
      uniform float plane, index;
      out vec2 before, after;
      out vec3 from;
      out float lost;
      void main() {
        bool up = plane > 0.0;
        from = point - place[0].xyz;
        vec3 bent = refract(normalize(from), up ? -normal : normal, up ? index : 1.0 / index);
        float t = (plane - point.z) / (abs(bent.z) < 0.05 ? 0.05 * sign(plane) : bent.z);
        vec3 q = point + max(t, 0.0) * bent;
        lost = dot(bent, bent) < 0.5 || t < 0.0 ? 1.0 : 0.0;
        before = point.xy;
        after = q.xy;
        gl_Position = camera * vec4(q.xy, plane, 1.0);
      }`,
      `${LIGHT}
      in vec2 before, after;
      in vec3 from;
      in float lost;
      uniform float plane, norm;
      void main() {
        if (lost > 0.0) discard;
        vec2 ax = dFdx(before), ay = dFdy(before), bx = dFdx(after), by = dFdy(after);
        float ratio = abs(ax.x * ay.y - ax.y * ay.x) / max(abs(bx.x * by.y - bx.y * by.x), 1e-9);
        float r = length(from), deep = place[0].w > 0.5 ? -plane : r;
        float light = pattern(from, 0) * exp(-extinction * deep) / (r * r) * abs(from.z) / r * min(ratio, 40.0) * norm;
        float seen = (1.0 - exp(-0.75 * light)) * smoothstep(0.02, 0.25, abs(normalize(eye - vec3(after, plane)).z));
        shade = vec4(screen(0.5 * beam) * seen, 0.35 * seen);
      }`],
    plain: [`#version 300 es
      in vec3 point, normal;
      uniform mat4 camera;
      out vec3 p, n;
      void main() { p = point; n = normal; gl_Position = camera * vec4(point, 1.0); }`,
      `#version 300 es
      precision highp float;
      in vec3 p, n;
      uniform vec4 color;
      uniform vec3 eye;
      uniform float lit, side; // brightness by the normal; the side of the sea that is drawn, 0 for both
      out vec4 shade;
      void main() {
        if (p.z * side < 0.0) discard;
        float turn = 0.62 + 0.38 * dot(normalize(n), normalize(vec3(-0.4, -0.5, 0.8)));
        float face = abs(dot(normalize(n), normalize(eye - p))), a = color.a < 1.0 ? color.a * mix(3.0, 0.6, smoothstep(0.0, 0.5, face)) : 1.0;
        shade = vec4(color.rgb * mix(1.0, turn, lit) * a, a);
      }`],
    line: [`#version 300 es
      in vec3 start, end;
      in float kind;
      uniform mat4 camera;
      uniform vec2 pixels;
      uniform float width;
      out float which, off;
      out vec3 p;
      void main() {
        p = gl_VertexID > 1 ? end : start;
        vec4 a = camera * vec4(start, 1.0), b = camera * vec4(end, 1.0);
        vec2 along = (b.xy / b.w - a.xy / a.w) * pixels;
        vec2 across = length(along) > 0.0 ? normalize(vec2(-along.y, along.x)) : vec2(0.0);
        off = float(gl_VertexID & 1) * 2.0 - 1.0;
        which = kind;
        vec4 at = gl_VertexID > 1 ? b : a;
        gl_Position = at + vec4(across * off * width / pixels * at.w, 0.0, 0.0);
      }`,
      `#version 300 es
      precision highp float;
      in float which, off;
      in vec3 p;
      uniform vec3 colors[4]; // received light, unscattered and scattered, and two kinds of other photons
      uniform vec2 middle;
      uniform float alpha, faint, halfWidth, bottom, top;
      out vec4 shade;
      void main() {
        float a = alpha * (1.0 - smoothstep(0.3, 1.0, abs(off)));
        if (which > 1.5) { // fades at the sides of the block, beyond which it leads
          vec2 side = halfWidth - abs(p.xy - middle);
          a *= faint * smoothstep(0.0, 0.15 * halfWidth, min(min(side.x, side.y), min(p.z - bottom, top - p.z)));
        }
        shade = vec4(colors[int(which + 0.5)] * a, a);
      }`],
    dots: [`#version 300 es
      in vec3 point;
      uniform mat4 camera;
      uniform float size;
      void main() { gl_Position = camera * vec4(point, 1.0); gl_PointSize = size * (1.0 + float(gl_VertexID % 3)); }`,
      `#version 300 es
      precision highp float;
      out vec4 shade;
      void main() { float a = 0.5 * (1.0 - smoothstep(0.2, 0.5, length(gl_PointCoord - 0.5))); shade = vec4(a); }`],
    tinted: [`#version 300 es
      in vec3 point, normal, tint;
      uniform mat4 camera;
      out vec3 n, color;
      void main() { n = normal; color = tint; gl_Position = camera * vec4(point, 1.0); }`,
      `#version 300 es
      precision highp float;
      in vec3 n, color;
      out vec4 shade;
      void main() { shade = vec4(color * (0.7 + 0.3 * abs(dot(normalize(n), vec3(-0.4, -0.5, 0.77)))), 1.0); }`],
    lamp: [`#version 300 es
      uniform mat4 camera;
      uniform vec3 center;
      uniform vec2 pixels;
      uniform float size;
      out vec2 at;
      void main() {
        at = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
        vec4 p = camera * vec4(center, 1.0);
        gl_Position = p + vec4(at * size / pixels * p.w, 0.0, 0.0);
      }`,
      `#version 300 es
      precision highp float;
      in vec2 at;
      uniform vec3 color;
      uniform float faint;
      out vec4 shade;
      void main() {
        float r = length(at), core = 1.0 - smoothstep(0.2, 0.26, r), halo = exp(-9.0 * r * r) * (1.0 - smoothstep(0.8, 1.0, r));
        shade = vec4(mix(color * halo, vec3(1.0), core), max(core, 0.4 * halo)) * faint;
      }`],
    map: [`#version 300 es
      uniform mat4 camera;
      uniform vec4 box;
      uniform float plane;
      out vec2 at;
      void main() {
        at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
        gl_Position = camera * vec4(mix(box.x, box.y, at.x), mix(box.z, box.w, at.y), plane, 1.0);
      }`,
      `#version 300 es
      precision highp float;
      in vec2 at;
      uniform sampler2D image;
      out vec4 shade;
      void main() { vec4 c = texture(image, at); shade = vec4(c.rgb * c.a, c.a); }`],
  };

  window.meshtraceShaders = { LAMPS, SHADERS };
})();
