/* Linked into what draws when the leak checker is on: libraries stay loaded until the end. Mesa keeps tables of its
 * driver in static variables and unloads the driver with eglTerminate; after that the checker knows neither the tables'
 * owner nor a name that a suppression could give. */
int dlclose(void *library);
int dlclose(void *library) {
    (void)library;
    return 0;
}
