/* A subscriber in C on rcl, the layer that rclcpp and rclpy share; built and run by
 * rcl_subscriber.py.
 *
 * It takes as their executors do: one message of each topic that has any, then it waits again.
 * TYPE is as ROS writes it, std_msgs/msg/Float32. A line of its standard input is answered by
 * one of JSON, as tutorial_subscriber.py answers: for each topic a list of what came, the
 * numbers of Float32 and null for each message of another type.
 */
#include <dlfcn.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <rcl/error_handling.h>
#include <rcl/rcl.h>
#include <rosidl_typesupport_introspection_c/field_types.h>
#include <rosidl_typesupport_introspection_c/message_introspection.h>

typedef rosidl_typesupport_introspection_c__MessageMembers Members;

struct topic {
    const char *name;
    rcl_subscription_t subscription;
    void *message;
    /* Of a Float32 in its message; NULL for other types. */
    const float *number;
    size_t count, room;
    float *numbers;
};

/* Held by whoever reads or changes what came. */
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct topic *topics;
static size_t topic_count;

static void fail(const char *what, const char *why)
{
    fprintf(stderr, "%s: %s\n", what, why);
    _Exit(1);
}

static void require(rcl_ret_t result, const char *what)
{
    if (result != RCL_RET_OK)
        fail(what, rcl_get_error_string().str);
}

static void *allocated(void *memory)
{
    if (!memory)
        fail("memory", "there is none left");
    return memory;
}

/* What a type support library knows of a message type. */
static const rosidl_message_type_support_t *type_support(const char *kind, const char *type)
{
    char package[64], name[64], library_name[192], symbol[320];
    const rosidl_message_type_support_t *(*handle)(void);
    void *library;

    if (sscanf(type, "%63[^/]/msg/%63s", package, name) != 2)
        fail(type, "is no message type");
    snprintf(library_name, sizeof library_name, "lib%s__%s.so", package, kind);
    snprintf(symbol, sizeof symbol, "%s__get_message_type_support_handle__%s__msg__%s", kind,
             package, name);
    library = dlopen(library_name, RTLD_NOW);
    if (!library)
        fail(type, dlerror());
    *(void **)&handle = dlsym(library, symbol);
    if (!handle)
        fail(type, dlerror());
    return handle();
}

static void make_message(struct topic *topic, const char *type)
{
    const Members *members = type_support("rosidl_typesupport_introspection_c", type)->data;

    topic->message = allocated(calloc(1, members->size_of_));
    members->init_function(topic->message, ROSIDL_RUNTIME_C_MSG_INIT_ALL);
    if (!strcmp(type, "std_msgs/msg/Float32"))
        topic->number = (float *)((char *)topic->message + members->members_[0].offset_);
}

static void subscribe(struct topic *topic, rcl_node_t *node, const char *name, const char *type,
                      const rcl_subscription_options_t *options)
{
    topic->name = name;
    make_message(topic, type);
    topic->subscription = rcl_get_zero_initialized_subscription();
    require(rcl_subscription_init(&topic->subscription, node,
                                  type_support("rosidl_typesupport_c", type), name, options),
            name);
}

static rcl_subscription_options_t options_of(const char *depth, const char *reliability)
{
    rcl_subscription_options_t options = rcl_subscription_get_default_options();

    options.qos.depth = strtoul(depth, NULL, 10);
    if (!strcmp(reliability, "best_effort"))
        options.qos.reliability = RMW_QOS_POLICY_RELIABILITY_BEST_EFFORT;
    else if (!strcmp(reliability, "reliable"))
        options.qos.reliability = RMW_QOS_POLICY_RELIABILITY_RELIABLE;
    else
        fail(reliability, "is neither reliable nor best_effort");
    return options;
}

static void start(rcl_context_t *context, rcl_node_t *node)
{
    rcl_init_options_t init = rcl_get_zero_initialized_init_options();
    rcl_node_options_t options = rcl_node_get_default_options();

    *context = rcl_get_zero_initialized_context();
    *node = rcl_get_zero_initialized_node();
    require(rcl_init_options_init(&init, rcl_get_default_allocator()), "options");
    require(rcl_init(0, NULL, &init, context), "context");
    require(rcl_node_init(node, "rcl_subscriber", "", context, &options), "node");
}

static void note(struct topic *topic)
{
    if (topic->count == topic->room) {
        topic->room = topic->room ? 2 * topic->room : 1024;
        topic->numbers = allocated(realloc(topic->numbers, topic->room * sizeof(float)));
    }
    topic->numbers[topic->count++] = topic->number ? *topic->number : 0.0F;
}

static void take(struct topic *topic)
{
    rcl_ret_t result = rcl_take(&topic->subscription, topic->message, NULL, NULL);

    /* DDS may wake for a message that another has replaced meanwhile. */
    if (result == RCL_RET_SUBSCRIPTION_TAKE_FAILED) {
        rcl_reset_error();
        return;
    }
    require(result, topic->name);
    pthread_mutex_lock(&lock);
    note(topic);
    pthread_mutex_unlock(&lock);
}

static void turn(rcl_wait_set_t *set)
{
    require(rcl_wait_set_clear(set), "wait set");
    for (size_t i = 0; i < topic_count; i++)
        require(rcl_wait_set_add_subscription(set, &topics[i].subscription, NULL), "wait set");
    require(rcl_wait(set, -1), "waiting");
    for (size_t i = 0; i < topic_count; i++)
        if (set->subscriptions[i])
            take(&topics[i]);
}

static void print_topic(const struct topic *topic)
{
    printf("\"%s\": [", topic->name);
    for (size_t i = 0; i < topic->count; i++) {
        const char *comma = i ? ", " : "";

        if (!topic->number)
            printf("%snull", comma);
        else if (topic->numbers[i] != topic->numbers[i])
            printf("%sNaN", comma);
        else
            printf("%s%.9g", comma, topic->numbers[i]);
    }
    printf("]");
}

static void answer(void)
{
    pthread_mutex_lock(&lock);
    printf("{");
    for (size_t i = 0; i < topic_count; i++) {
        printf("%s", i ? ", " : "");
        print_topic(&topics[i]);
    }
    printf("}\n");
    fflush(stdout);
    pthread_mutex_unlock(&lock);
}

static void *answer_all(void *nothing)
{
    for (int letter = getchar(); letter != EOF; letter = getchar())
        if (letter == '\n')
            answer();
    /* Nothing is left to be done, and the other thread waits for ever. */
    _Exit(0);
    return nothing;
}

/* Words are the library, depth, reliability, and topics with their types. */
int subscribe_to_all(int count, char **words)
{
    rcl_wait_set_t set = rcl_get_zero_initialized_wait_set();
    rcl_subscription_options_t options;
    rcl_context_t context;
    rcl_node_t node;
    pthread_t reader;

    if (count < 5 || count % 2 == 0)
        fail("usage", "DEPTH reliable|best_effort TOPIC TYPE...");
    options = options_of(words[1], words[2]);
    start(&context, &node);
    topic_count = (size_t)(count - 3) / 2;
    topics = allocated(calloc(topic_count, sizeof *topics));
    for (size_t i = 0; i < topic_count; i++)
        subscribe(&topics[i], &node, words[2 * i + 3], words[2 * i + 4], &options);
    require(rcl_wait_set_init(&set, topic_count, 0, 0, 0, 0, 0, &context,
                              rcl_get_default_allocator()),
            "wait set");
    if (pthread_create(&reader, NULL, answer_all, NULL))
        fail("thread", "cannot be started");
    for (;;)
        turn(&set);
}
