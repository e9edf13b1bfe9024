// A peer of another DDS (eProsima's Fast DDS) for tests: it drives a robot of ROS 2 and says what it hears of it.
#include <chrono>
#include <cstdlib>
#include <iostream>
#include <string>
#include <thread>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#include "ros2PubSubTypes.h"
using namespace eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

int main(int, char** arguments) {
    const int domain = std::atoi(arguments[1]);
    DomainParticipantQos own;
    auto loopback = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    loopback->interfaceWhiteList.push_back("127.0.0.1");
    own.transport().use_builtin_transports = false;
    own.transport().user_transports.push_back(loopback);
    for (int k = 0; k < 8; ++k) { // the ports of the first participants of a domain (DDSI-RTPS 9.6.2)
        rtps::Locator_t peer;
        rtps::IPLocator::setIPv4(peer, "127.0.0.1");
        peer.port = 7400 + 250 * domain + 10 + 2 * k;
        own.wire_protocol().builtin.initialPeersList.push_back(peer);
    }
    auto* node = DomainParticipantFactory::get_instance()->create_participant(domain, own);
    if (!node) return 2;
    TypeSupport twist(new geometry_msgs::msg::dds_::Twist_PubSubType()), text(new std_msgs::msg::dds_::String_PubSubType()),
        odometry(new nav_msgs::msg::dds_::Odometry_PubSubType());
    for (auto* type : {&twist, &text, &odometry}) type->register_type(node);
    auto* out = node->create_publisher(PUBLISHER_QOS_DEFAULT);
    auto* in = node->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    DataReaderQos sensor = DATAREADER_QOS_DEFAULT, latched = DATAREADER_QOS_DEFAULT;
    latched.reliability().kind = RELIABLE_RELIABILITY_QOS;
    latched.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    auto* command = out->create_datawriter(
        node->create_topic("rt/cmd_vel", twist.get_type_name(), TOPIC_QOS_DEFAULT), DATAWRITER_QOS_DEFAULT);
    auto* feedback = in->create_datareader(
        node->create_topic("rt/platform/odom/filtered", odometry.get_type_name(), TOPIC_QOS_DEFAULT), sensor);
    auto* urdf = in->create_datareader(
        node->create_topic("rt/robot_description", text.get_type_name(), TOPIC_QOS_DEFAULT), latched);
    geometry_msgs::msg::dds_::Twist_ drive;
    drive.linear().x(0.25);
    nav_msgs::msg::dds_::Odometry_ seen;
    std_msgs::msg::dds_::String_ description;
    SampleInfo info;
    int count = 0;
    const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(std::atoi(arguments[2]));
    while (std::chrono::steady_clock::now() < until) {
        command->write(&drive);
        while (feedback->take_next_sample(&seen, &info) == ReturnCode_t::RETCODE_OK) count += info.valid_data;
        if (urdf->take_next_sample(&description, &info) == ReturnCode_t::RETCODE_OK && info.valid_data)
            std::cout << "description of " << description.data().size() << " characters" << std::endl;
        if (count && !description.data().empty() && seen.pose().pose().position().x() > 0.2) {
            std::cout << count << " odometries, " << seen.header().frame_id() << " to " << seen.child_frame_id() << ", x "
                      << seen.pose().pose().position().x() << std::endl;
            return 0;
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    std::cout << "only " << count << " odometries, x " << seen.pose().pose().position().x() << std::endl;
    return 1;
}
