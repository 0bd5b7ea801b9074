#version 300 es
// The kernel of lfrender/rendering/blend/blend_pixels.py as a shader, in the symbols of docs/geometry.md: a lens at c shows the
// scene point X at c + q - (X - c) s / D. With WARP defined, the surface visible from q (lfrender/rendering/warped_surface.py).
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;

uniform sampler2D surface;       // s at every grid point, and 1 where it was measured
uniform vec2 surfaceFirst;
uniform float cell, edge;
uniform float pitch;
uniform vec2 view;               // q
out vec4 result;

vec2 gridValue(ivec2 at) { return texelFetch(surface, at, 0).rg; }

// Linear between grid values, nearest across a depth edge.
vec2 surfaceAt(vec2 X) {
  ivec2 size = textureSize(surface, 0);
  vec2 g = clamp((X - surfaceFirst) / cell, vec2(0.0), vec2(size - 1));
  ivec2 low = min(ivec2(g), max(size - 2, 0)), high = min(low + 1, size - 1);
  vec2 f = g - vec2(low);
  vec2 a = gridValue(low), b = gridValue(ivec2(high.x, low.y));
  vec2 c = gridValue(ivec2(low.x, high.y)), d = gridValue(high);
  if (max(max(a.x, b.x), max(c.x, d.x)) - min(min(a.x, b.x), min(c.x, d.x)) < edge)
    return mix(mix(a, b, f.x), mix(c, d, f.x), f.y);
  return gridValue(ivec2(f.x > 0.5 ? high.x : low.x, f.y > 0.5 ? high.y : low.y));
}

#ifdef WARP

uniform float still, nearest, farthest, least;

void main() {
  vec2 Y = floor(gl_FragCoord.xy) * cell;
  vec2 found = gridValue(ivec2(gl_FragCoord.xy));
  float before = 0.0, above = 0.0;
  int steps = max(1, int(ceil((farthest - nearest) * length(view) / (0.5 * cell))));
  float step = (farthest - nearest) / float(steps);
  for (int k = 0; k <= steps; k++) {
    float depth = nearest + float(k) * step;
    found = surfaceAt(surfaceFirst + Y - view * (depth - still));
    float bounded = abs(found.x) >= least ? found.x : (found.x >= 0.0 ? least : -least);
    float left = pitch / bounded - depth;
    if (left <= 0.0) {
      if (k > 0 && abs(found.x - before) < edge) found.x = before + (found.x - before) * above / (above - left);
      else if (k > 0) found.x = before;
      break;
    }
    before = found.x;
    above = left;
  }
  result = vec4(found, 0.0, 1.0);
}

#else

uniform sampler2DArray flatTiles, occlusionTiles;
uniform sampler2D rings, displacements, shares, averaged, ramp, traditional;
uniform highp isampler2D types;
uniform vec2 flatSize;
uniform float tileStep, tileSide;
uniform ivec2 tileCount;
uniform bool hasOcclusion;
uniform float ringStep;
uniform vec2 origin;
uniform mat2 basis, inverseBasis;   // columns are the rows of the tables: index = inverseBasis * offset
uniform ivec2 displacementsLow;
uniform float radius;               // usable radius times aperture
uniform float plane;                // the one s of all places, or 0 for the surface
uniform vec2 between;               // ends of the range of depths that are sharp, toward the camera; first > second: none
uniform vec2 corner;                // of the picture, on what is drawn into
uniform float exposure;             // factor on the light of all colours
uniform vec2 first;                 // X of the middle of pixel (0, 0)
uniform float spacing;              // between pixels, in X
uniform vec3 offsets[128];          // of lenses from the nearest one, and their least distance from X
uniform int offsetCount;
uniform vec2 moved;                 // what was added to X for the viewpoint
uniform float reach, agreement;        // of places out of their own depth ...
uniform float reachOwn, agreementOwn;  // ... and of those that are drawn at it
uniform float rows;                 // of the picture
uniform float most;                 // sub-samples along a pixel's side; fewer while something moves
uniform float overlay;              // share of the colours of depth
uniform vec2 limits;                // far and near end of the scale of depth
uniform vec3 background;
uniform vec2 traditionalFirst;      // X of the first pixel of the traditional picture
uniform float traditionalStep;      // between its pixels, in X; 0 where another picture is drawn

const int MOST = 37;
const float OCCLUDED_WEIGHT = 1e-4;

// Whether the place whose size was asked for last is drawn at its own depth.
bool own;
// Whether lenses out of the usual reach take part.
bool far = false;

// Entry of a row of a table over s / D.
float atRatio(sampler2D table, float ratio, int row) {
  int end = textureSize(table, 0).x - 1;
  return texelFetch(table, ivec2(clamp(int((ratio + 1.0) * 0.5 * float(end) + 0.5), 0, end), row), 0).r;
}

float sizeAt(vec2 X) {
  own = plane == 0.0;
  if (!own && between.x > between.y) return plane;
  float s = surfaceAt(X).x;
  if (own) return s;
  float near = s > 0.0 ? s : s + 2.0 * pitch, held = clamp(near, between.x, between.y);
  own = held == near;
  return held < pitch ? held : held - 2.0 * pitch;
}

// Largest |s| at the corners of a pixel that straddles a depth edge; zero for other pixels.
float largestAtEdge(vec2 X, float s) {
  float h = 0.5 * spacing, largest = abs(s);
  bool crosses = false;
  for (int corner = 0; corner < 4 && own; corner++) {
    vec2 to = vec2((corner & 1) == 1 ? h : -h, (corner & 2) == 2 ? h : -h);
    float other = surfaceAt(X + to).x;
    crosses = crosses || abs(other - s) > edge;
    largest = max(largest, abs(other));
  }
  return crosses ? largest : 0.0;
}

vec2 displacementOf(ivec2 index) {
  ivec2 at = clamp(index - displacementsLow, ivec2(0), textureSize(displacements, 0) - 1);
  return texelFetch(displacements, at, 0).rg;
}

bool isDistorted() { return textureSize(displacements, 0).x > 1; }

vec2 nearestIndex(vec2 X) {
  vec2 o = X - origin, index = round(inverseBasis * o);
  if (isDistorted()) {
    for (int turn = 0; turn < 6; turn++) {
      vec2 next = round(inverseBasis * (o - displacementOf(ivec2(index))));
      if (next == index) break;
      index = next;
    }
  }
  return index;
}

// Tiles begin a pixel before their part of the flat.
vec3 tilePlace(vec2 p, out ivec2 inside) {
  ivec2 tile = clamp(ivec2(p / tileStep), ivec2(0), tileCount - 1);
  vec2 local = p - vec2(tile) * tileStep + 1.0;
  inside = ivec2(local + 0.5);
  return vec3((local + 0.5) / tileSide, float(tile.y * tileCount.x + tile.x));
}

struct LensSample { vec3 colour; float weight; float distance; };

// Colour and weight of X in the lens at offset `o` from the nearest one; the weight is 0 if the lens does not show X.
LensSample sampleLens(vec2 X, vec2 base, ivec2 index, int o, float s, float limit) {
  LensSample none = LensSample(vec3(0.0), 0.0, 1e30);
  vec2 to = offsets[o].xy, e = base - to;
  ivec2 steps = ivec2(round(inverseBasis * to));
  if (isDistorted()) e -= displacementOf(index + steps);
  float d2 = dot(e, e), limit2 = limit * limit, slope = s / pitch, aside = length(view);
  if (d2 > limit2) return none;
  vec2 delta = view - e * slope;
  float delta2 = dot(delta, delta), radius2 = (radius - 1.0) * (radius - 1.0);
  if (aside > 0.0 && delta2 > radius2) return none;
  vec2 c = X - e, p = c + delta;
  if (any(lessThan(p, vec2(0.0))) || any(greaterThan(p, flatSize - 1.0))) return none;
  if (any(lessThan(c, vec2(-0.5))) || any(greaterThanEqual(c, flatSize - 0.5))) return none;
  int last = textureSize(rings, 0).x - 1;
  vec2 ring = texelFetch(rings, ivec2(min(int(delta2 / ringStep), last), 0), 0).rg;
  ivec2 inside;
  vec3 place = tilePlace(p, inside);
  vec3 colour = ring.x * textureLod(flatTiles, place, 0.0).rgb;
  float offCentre = d2 / limit2;
  if (aside > 0.0) offCentre = max(offCentre, delta2 / radius2);
  float weight = (1.02 - offCentre) * ring.y * ring.y;
  ivec2 kinds = textureSize(types, 0);
  if (kinds.x > 1) {
    ivec2 at = ((index + steps) % kinds + kinds) % kinds;
    weight *= atRatio(shares, slope, texelFetch(types, at.yx, 0).r);
  }
  if (hasOcclusion) {
    vec3 code = round(texelFetch(occlusionTiles, ivec3(inside, int(place.z)), 0).rgb * 255.0);
    float value = code.x * 256.0 + code.y;
    bool unlit = value > 65534.5, known = value > 0.5 && (code.z > 0.5 || aside > 0.0);
    // The surface visible through the centre of the main lens may differ from that visible from a viewpoint beside it.
    float share = aside > 0.0 || code.z > 254.5 ? (value - 1.0) / 65533.0 : (code.z - 1.0) / 253.0;
    float depth = (share * 2.0 - 1.0) * pitch;
    if (unlit || (own && known && abs(depth - s) > 2.0 * edge)) {
      weight *= OCCLUDED_WEIGHT;
      d2 += limit2;
    }
  }
  return LensSample(colour, weight, d2);
}

// Colour at X, and in alpha whether any lens shows it.
vec4 colourAt(vec2 X, float s) {
  vec2 index = nearestIndex(X);
  vec2 base = X - origin - basis * index;
  ivec2 at = ivec2(index);
  float slope = abs(s) / pitch;
  float limit = min((radius + (own ? length(view) : 0.0)) / max(slope, 1e-6), own && !far ? reachOwn : reach);
  float tolerance = own ? agreementOwn : agreement;
  float beside = isDistorted() ? 0.75 * pitch : length(base), farthest = limit + beside;
  int found = 0;
  vec3 mean = vec3(0.0), central = vec3(0.0);
  float norm = 0.0, best = 1e30;
  for (int o = 0; o < offsetCount; o++) {
    if (offsets[o].z > farthest || found == MOST) break;
    LensSample one = sampleLens(X, base, at, o, s, limit);
    if (one.distance > 1e29) continue;
    if (one.distance < best) {
      best = one.distance;
      central = one.colour;
      // One lens is enough; all others in the list are farther away.
      if (tolerance <= 0.0) farthest = min(farthest, sqrt(best) + beside);
    }
    mean += one.weight * one.colour;
    norm += one.weight;
    found++;
  }
  if (found == 0) return vec4(0.0);
  if (tolerance <= 0.0) return vec4(central, 1.0);
  mean /= norm;
  if (tolerance > 100.0) return vec4(mean, 1.0);
  float t2 = tolerance * tolerance;
  vec3 mixed = vec3(0.0);
  norm = 0.0;
  found = 0;
  for (int o = 0; o < offsetCount; o++) {
    if (offsets[o].z > farthest || found == MOST) break;
    LensSample one = sampleLens(X, base, at, o, s, limit);
    if (one.distance > 1e29) continue;
    vec3 difference = one.colour - mean;
    float agree = t2 / (t2 + dot(difference, difference) / 3.0);
    float weight = one.weight * agree * agree;
    mixed += weight * one.colour;
    norm += weight;
    found++;
  }
  return vec4(mixed / norm, 1.0);
}

// Values of sRGB with `exposure` times their light; as encode_srgb and decode_srgb in Python.
vec3 brighten(vec3 shown) {
  if (exposure == 1.0) return shown;
  shown = max(shown, 0.0);
  vec3 light = exposure * mix(shown / 12.92, pow((shown + 0.055) / 1.055, vec3(2.4)), step(0.04045, shown));
  return mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));
}

vec3 depthColour(vec2 X) {
  vec2 found = surfaceAt(X);
  if (found.y < 0.5) return vec3(0.59);
  float order = found.x / pitch + (found.x < 0.0 ? 2.0 : 0.0);
  float share = (order - limits.x) / (limits.y - limits.x);
  return textureLod(ramp, vec2((clamp(share, 0.0, 1.0) * 255.0 + 0.5) / 256.0, 0.5), 0.0).rgb;
}

void main() {
  vec2 place = gl_FragCoord.xy - corner, pixel = vec2(place.x - 0.5, rows - 0.5 - place.y);
  vec2 X = first + pixel * spacing, shown = X - moved;
  // The picture ends with the flat, as that of the renderer.
  if (any(lessThan(shown, vec2(-0.5))) || any(greaterThan(shown, flatSize - 0.5))) {
    result = vec4(background, 1.0);
    return;
  }
  if (traditionalStep > 0.0) {
    vec2 at = ((shown - traditionalFirst) / traditionalStep + 0.5) / vec2(textureSize(traditional, 0));
    vec3 mean = brighten(textureLod(traditional, at, 0.0).rgb);
    result = vec4(overlay > 0.0 ? mix(mean, depthColour(X), overlay) : mean, 1.0);
    return;
  }
  float s = sizeAt(X), side = abs(s) * spacing / pitch, apart = 0.0;
  int across = 1;
  if (side > 1.0) {
    // As `count_samples` and `squares_to_average` of the renderer.
    float largest = largestAtEdge(X, s), whole = side * side - 1.0, blurred = atRatio(averaged, s / pitch, 0);
    float left = max(whole - blurred, 0.0) * (1.0 + blurred / (3.0 * whole));
    if (largest > 0.0) {
      across = min(int(ceil(largest * spacing / pitch / 0.5)), int(most));
      apart = spacing / float(across);
    } else if (left >= 0.25) {
      across = min(int(ceil(sqrt(left / 1.5 + 1.0))), int(most));
      apart = across == 1 ? 0.0 : sqrt(left / float(across * across - 1)) * spacing / side;
    }
  }
  vec4 total = vec4(0.0);
  // At the border, some places are seen by far lenses alone.
  for (int turn = 0; turn < 2 && total.a == 0.0; turn++) {
    far = turn == 1;
    for (int sub = 0; sub < across * across; sub++) {
      vec2 to = vec2(sub % across, sub / across) - 0.5 * float(across - 1);
      vec2 at = X + to * apart;
      total += colourAt(at, across == 1 ? s : sizeAt(at));
    }
  }
  vec3 colour = total.a > 0.0 ? brighten(total.rgb / total.a) : background;
  if (overlay > 0.0 && total.a > 0.0) colour = mix(colour, depthColour(X), overlay);
  result = vec4(colour, 1.0);
}

#endif
