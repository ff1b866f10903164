/* Learns from a demonstration, recognises the thing in another picture, and plans its opening:
 *
 *   example STORE OBJECT DEMONSTRATION FRAMES ENCOUNTER
 *
 * A folder holds camera.txt (width height fx fy cx cy), and pictures 0.ppm and 0.pgm (16 bits,
 * millimetres), 1.ppm and so on. FRAMES is how many the demonstration has; ENCOUNTER holds one. */
#include <linkage.h>
#include <stdio.h>
#include <stdlib.h>

struct picture { int width, height, bytes; uint8_t *data; };

static void *must(void *memory, const char *what) {
  if (!memory) { fprintf(stderr, "example: %s\n", what); exit(2); }
  return memory;
}

/* Binary PPM and PGM; 16-bit values come with the high byte first and are turned. */
static struct picture read_picture(const char *folder, int number, const char *suffix) {
  char path[4096], kind;
  int largest;
  struct picture p;
  snprintf(path, sizeof path, "%s/%d.%s", folder, number, suffix);
  FILE *file = must(fopen(path, "rb"), path);
  if (fscanf(file, "P%c %d %d %d", &kind, &p.width, &p.height, &largest) != 4) must(NULL, path);
  fgetc(file);
  p.bytes = (kind == '6' ? 3 : 1) * (largest > 255 ? 2 : 1);
  size_t size = (size_t)p.width * p.height * p.bytes;
  p.data = must(malloc(size), "no memory");
  if (fread(p.data, 1, size, file) != size) must(NULL, path);
  fclose(file);
  if (largest > 255)
    for (size_t i = 0; i < size; i += 2)
      *(uint16_t *)(p.data + i) = (uint16_t)(p.data[i] << 8 | p.data[i + 1]);
  return p;
}

static linkage_camera read_camera(const char *folder) {
  char path[4096];
  linkage_camera c = {0};
  snprintf(path, sizeof path, "%s/camera.txt", folder);
  FILE *file = must(fopen(path, "r"), path);
  if (fscanf(file, "%u %u %lf %lf %lf %lf", &c.width, &c.height, &c.fx, &c.fy, &c.cx, &c.cy) != 6)
    must(NULL, path);
  fclose(file);
  return c;
}

/* Hands a frame of a folder to `use`. */
static linkage_result with_frame(const char *folder, int number, void *context,
                                 linkage_result (*use)(void *, const linkage_frame *)) {
  struct picture color = read_picture(folder, number, "ppm");
  struct picture depth = read_picture(folder, number, "pgm");
  linkage_frame frame = {
      .utime = 1000000 + 33333 * (int64_t)number,
      .camera = read_camera(folder),
      .rgb = color.data,
      .rgb_stride = (size_t)color.width * 3,
      .depth = depth.data,
      .depth_stride = (size_t)depth.width * 2,
      .depth_format = LINKAGE_DEPTH_FORMAT_MILLIMETRES_U16,
  };
  linkage_result result = use(context, &frame);
  free(color.data);
  free(depth.data);
  return result;
}

static linkage_result feed(void *session, const linkage_frame *frame) {
  return linkage_feed(session, frame);
}

struct search { linkage_session *session; linkage_recognition *found; };

static linkage_result recognise(void *context, const linkage_frame *frame) {
  struct search *s = context;
  return linkage_recognise(s->session, frame, &s->found);
}

static void check(linkage_result result, const char *what) {
  if (result == LINKAGE_RESULT_OK) return;
  fprintf(stderr, "example: %s: %s\n", what, linkage_last_error());
  exit((int)result);
}

int main(int count, char **arguments) {
  if (count != 6) must(NULL, "STORE OBJECT DEMONSTRATION FRAMES ENCOUNTER");
  struct search search = {0};
  check(linkage_open(arguments[1], NULL, NULL, &search.session), "open");
  printf("linkage %s knows %zu objects\n", linkage_version(), linkage_object_count(search.session));

  check(linkage_start_demonstration(search.session, arguments[2]), "start");
  for (int i = 0; i < atoi(arguments[4]); i++)
    check(with_frame(arguments[3], i, search.session, feed), "feed");
  linkage_result learned = linkage_finish_demonstration(search.session);
  if (learned == LINKAGE_RESULT_NO_ANSWER)
    printf("not learned: %s\n", linkage_last_error());
  else
    check(learned, "finish");

  check(with_frame(arguments[5], 0, &search, recognise), "recognise");
  for (size_t m = 0; m < linkage_match_count(search.found); m++) {
    linkage_match match;
    check(linkage_match_at(search.found, m, &match), "match");
    printf("%s: score %.2f\n", match.object, match.score);
    for (size_t j = 0; j < match.joint_count; j++) {
      linkage_joint joint;
      check(linkage_joint_at(search.found, m, j, &joint), "joint");
      if (joint.configuration_known)
        printf("  %s, %s, at %.3f of %.3f to %.3f\n", joint.name, joint.kind, joint.configuration,
               joint.range[0], joint.range[1]);
      else
        printf("  %s, %s: %s\n", joint.name, joint.kind, joint.reason);
    }
    linkage_request request = {.target = "open"};
    linkage_prediction *plan;
    check(linkage_predict(search.session, search.found, m, &request, &plan), "predict");
    for (size_t t = 0; t < linkage_trajectory_count(plan); t++) {
      linkage_trajectory trajectory;
      linkage_point first, last;
      check(linkage_trajectory_at(plan, t, &trajectory), "trajectory");
      check(linkage_point_at(plan, t, 0, &first), "point");
      check(linkage_point_at(plan, t, trajectory.point_count - 1, &last), "point");
      printf("  %s goes from %.3f to %.3f in %.2f s\n", trajectory.joint, first.position,
             last.position, last.time);
    }
    linkage_free_prediction(plan);
  }
  linkage_free_recognition(search.found);
  linkage_close(search.session);
  return 0;
}
