#version 300 es
// As lfrender/flat/prefilter.py: sharpen pixels so that linear interpolation does not blur them, in whole grey levels.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D plain;
out vec4 result;

vec3 level(ivec2 at) { return round(255.0 * texelFetch(plain, clamp(at, ivec2(0), textureSize(plain, 0) - 1), 0).rgb); }

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy), x = ivec2(1, 0), y = ivec2(0, 1);
  vec3 sides = level(at - x) + level(at + x) + level(at - y) + level(at + y);
  vec3 twelfths = max(16.0 * level(at) - sides + 6.0, 0.0);
  result = vec4(min(floor((twelfths + 0.5) / 12.0), 255.0) / 255.0, 1.0);
}
